"""What is turned, one at a time, and the scene folder of each value.

All else is alike: the suite's vase in a room, VIEWS photos, given cameras and mesh, one sample.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.make_scene import Options
from benchmarks.stability.scenes import BASES, DONE, Recipe, Size, base_recipe, rendered
from benchmarks.suite.patches import Patch
from pipeline.base.files import read_json, stage_folder

VIEWS = 16
SIZE = Size(Options(size=256, spp=32, views=VIEWS, test=1))
MOST_VIEWS = 128


@dataclass(frozen=True)
class Knob:
    """scene: makes the scene folder of a value below a folder, or finds it there; settings: what
    the configuration has for a value, besides the preset.
    """

    title: str
    values: tuple[int, ...]
    scene: Callable[[int, Path], Path]
    settings: Callable[[int], dict]


def made(name: str, recipe: Recipe, out: Path) -> Path:
    folder = out / name
    if not (folder / DONE).exists():
        rendered(recipe, folder)
    return folder


def base(value: int, out: Path) -> Path:
    """The scene that most values share."""
    return made("base", base_recipe(BASES["vase"], SIZE), out)


def of_views(count: int, out: Path) -> Path:
    """`count` of MOST_VIEWS photos, evenly; without a mesh, so that the surface is made of them."""
    recipe = base_recipe(BASES["vase"], SIZE)
    many = replace(recipe, options=replace(recipe.options, views=MOST_VIEWS))
    origin, folder = made("views", many, out), out / f"views_{count}"
    if (folder / DONE).exists():
        return folder

    cameras = read_json(origin / DONE)
    chosen = np.linspace(0, MOST_VIEWS, count, endpoint=False).astype(int)
    cameras["frames"] = [cameras["frames"][k] for k in chosen]
    with stage_folder(folder, DONE) as new:
        for frame in cameras["frames"]:
            for file in (frame["file_path"], frame["mask_path"]):
                (new / file).parent.mkdir(exist_ok=True)
                shutil.copy2(origin / file, new / file)
        (new / DONE).write_text(json.dumps(cameras, indent=1), encoding="utf-8")
    return folder


def finer(patches: list[Patch], factor: float) -> list[Patch]:
    """The patches with about `factor` times as many quads."""
    along = np.sqrt(factor)
    cells = lambda patch: tuple(max(2, round(c * along)) for c in patch.cells)
    return [replace(patch, cells=cells(patch)) for patch in patches]


def of_faces(count: int, out: Path) -> Path:
    """The same vase given as a mesh of about `count` triangles."""
    recipe = base_recipe(BASES["vase"], SIZE)
    patches = recipe.thing.patches()
    factor = count / (2 * sum(a * b for a, b in (patch.cells for patch in patches)))
    thing = replace(recipe.thing, patches=lambda: finer(patches, factor))
    return made(f"faces_{count}", replace(recipe, thing=thing), out)


nothing = lambda value: {}
texels = lambda side: {"atlas": {"resolution": side}, "refine": {"texture": side}}

KNOBS: dict[str, Knob] = {
    "views": Knob("photos", (8, 16, 32, 64, 128), of_views, nothing),
    "texture": Knob("texels a side", (256, 512, 1024, 2048, 4096), base, texels),
    "samples": Knob("samples", (1, 2, 4, 8, 16, 32), base, lambda count: {"samples": count}),
    "faces": Knob("triangles", (1000, 10_000, 100_000, 1_000_000), of_faces, nothing),
}
