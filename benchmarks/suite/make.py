"""Make the procedural suite's scene folders, from this repository alone.

python -m benchmarks.suite.make --suite XS --out FOLDER

FOLDER/<suite>_<object>__<light> is a scene of benchmarks.make_scene, with relights under one light
of each sort that is not its own. FOLDER/assets and FOLDER/lights hold what it was rendered from. A
scene that is there already is not made again, and two processes may fill one folder. Rendered on
one thread, a suite has the same bits whenever it is made on a machine.

Suite S: eight objects (diffuse, glossy, metal, mixed, concave), each under an indoor and an outdoor
light; XS: three of them, each under one light, small, for minutes; W: all eight under one light of
each of four kinds, tiny pictures, for figures that need many scenes.
"""

from __future__ import annotations

import argparse
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

from benchmarks.make_scene import Options, make_scene
from benchmarks.suite.lights import INDOOR, make_light
from benchmarks.suite.objects import LAST, OBJECTS, write_object
from pipeline.base.errors import InputError, nearest, run_stage
from pipeline.base.images import write_exr
from pipeline.base.locks import alone
from pipeline.base.runtime import set_threads

RELIGHTS = {"indoor": ("room_90", "studio_90"), "outdoor": ("sunny_90", "cloudy_90")}
LIGHT_ROWS = 128
KINDS = (*INDOOR, "sunny", "cloudy")


@dataclass
class Suite:
    """pairs: (object, light) of every scene; side: texels along a side of the true maps."""

    pairs: list[tuple[str, str]]
    options: Options
    side: int


def indoor_and_outdoor(number: int) -> tuple[str, str]:
    """Lights of an object by its number: kinds take turns, and no two scenes share a light."""
    indoor = f"{INDOOR[number % 2]}_{number}"
    outdoor = f"{('sunny', 'cloudy')[number // 2 % 2]}_{number}"
    return indoor, outdoor


SUITES = {
    "S": Suite(
        [(name, light) for k, name in enumerate(OBJECTS) for light in indoor_and_outdoor(k)],
        Options(size=256, spp=256, views=16, test=4),
        512,
    ),
    "XS": Suite(
        [("bowl", "cloudy_2"), ("vase", "room_4"), ("rounded_case", "sunny_1")],
        Options(size=128, spp=256, views=12, test=3),
        256,
    ),
    "W": Suite(
        [
            (name, f"{kind}_{10 * (1 + number) + k}")
            for k, name in enumerate(OBJECTS)
            for number, kind in enumerate(KINDS)
        ],
        Options(size=96, spp=64, views=12, test=2),
        128,
    ),
}


def suite_named(name: str) -> Suite:
    """Raises InputError for an unknown name."""
    if name not in SUITES:
        raise InputError(f"there is no suite '{name}'", "--suite", nearest(name, SUITES))
    return SUITES[name]


def relights_of(light: str) -> list[str]:
    """An indoor and an outdoor light that no scene of the suite has, of the kinds that `light` is
    not, where there is a choice.
    """
    kind = light.rpartition("_")[0]
    other = lambda names: next(n for n in names if not n.startswith(kind))
    return [other(RELIGHTS["indoor"]), other(RELIGHTS["outdoor"])]


def light_file(folder: Path, name: str) -> Path:
    """FOLDER/lights/<name>.exr, made when it is not there."""
    path = folder / "lights" / f"{name}.exr"
    if not path.exists():
        write_exr(path, make_light(name, LIGHT_ROWS))
    return path


def scene_name(suite: str, thing: str, light: str) -> str:
    """Of the folder of a pair's scene."""
    return f"{suite.lower()}_{thing}__{light}"


def make_suite(name: str, out: Path, only: list[str] | None = None) -> list[Path]:
    """The scene folders of a suite under `out`, in its order; `only`: names of those that are
    wanted, none: all. Raises InputError for an unknown suite or scene.
    """
    suite = suite_named(name)
    known = {scene_name(name, *pair): pair for pair in suite.pairs}
    wanted = scenes_named(only, known, f"suite {name}")
    out.mkdir(parents=True, exist_ok=True)
    for scene in wanted:
        with alone(out / f"making_{scene}", wait=True):  # studies may share a folder of scenes
            if not (out / scene).exists():
                make_one(suite, *known[scene], out, out / scene)
    return [out / scene for scene in wanted]


def scenes_named(
    only: list[str] | None, known: Collection[str], place: str, where: str | None = None
) -> list[str]:
    """The scenes `known` in `place`, in their order; `only`: names of those that are wanted, none:
    all. Raises InputError for an unknown one, said of the option `where` if one is named.
    """
    for asked in only or []:
        if asked not in known:
            raise InputError(f"{place} has no scene '{asked}'", where, nearest(asked, known))
    return [scene for scene in known if only is None or scene in only]


def make_one(suite: Suite, thing: str, light: str, out: Path, folder: Path) -> None:
    """The scene `folder`, and what it is rendered from below `out`."""
    asset = out / "assets" / f"{thing}_{suite.side}"
    with alone(out / "assets", wait=True):  # scenes share things and lights
        if not (asset / LAST).exists():  # another process may be reading it
            write_object(thing, asset, suite.side)
        others = [light_file(out, other) for other in relights_of(light)]
        own = light_file(out, light)
    make_scene(asset, own, others, suite.options, folder)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--suite", default="XS")
    parser.add_argument("--out", type=Path, required=True)
    args = parser.parse_args()
    set_threads(1)  # sums of floating-point numbers depend on the number of threads
    for folder in make_suite(args.suite, args.out):
        print(folder, flush=True)


if __name__ == "__main__":
    run_stage(main)
