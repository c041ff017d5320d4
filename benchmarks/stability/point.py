"""One point of the suite, in a process of its own: its scene, its stages to the fit, its draws.

python -m benchmarks.stability.point --knob blur --value 4 --methods map --out OUT

Rows are those of the comparative study (benchmarks/study/rows.py), one JSON file a draw below
OUT/rows/<scene>/<method>, and the draws themselves are kept below OUT/draws; what is there is not
made again. Where the pipeline refuses the scene, its reason is written to refused.json there: that
is a result, and the best one where nothing right can come of the input. One thread.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from benchmarks.stability.chain import chain
from benchmarks.stability.knobs import KNOBS, knob_named
from benchmarks.stability.points import Point, alone, make_scene_of
from benchmarks.stability.scenes import BASE, size_named
from benchmarks.study.methods import METHODS, OURS, methods_named, scene_for
from benchmarks.study.rows import measure
from pipeline.base.config import merge, parse_scene
from pipeline.base.errors import InputError, run_stage
from pipeline.base.files import read_json, write_json
from pipeline.base.runtime import set_threads

REFUSED = "refused.json"


def seeds_of(point: Point, method: str, most: int | None = None) -> list[int]:
    """Draws that a method makes of a point, `most` of them; none: all."""
    return (point.seeds if METHODS[method].drawn else [0])[:most]


def done(point: Point, method: str, out: Path, most: int | None = None) -> bool:
    """Whether a point's rows (`seeds_of`), or the reason why there is none, are there."""
    rows = out / "rows" / point.scene / method
    made = all((rows / f"{seed}.json").exists() for seed in seeds_of(point, method, most))
    return made or (rows / REFUSED).exists()


def run(point: Point, methods: list[str], out: Path, most: int | None = None) -> None:
    """Make what is not there of a point's rows, `most` draws of it (`seeds_of`)."""
    with alone(out / "scenes"):
        folder = make_scene_of(point, out / "scenes").resolve()
    shared = scene_for(OURS, str(folder)).model_dump(mode="json")
    own = merge(size_named(point.size).settings, KNOBS[point.knob].settings)
    scene = parse_scene(merge(shared, own), "benchmarks.stability")
    for method in methods:
        if done(point, method, out, most):
            continue
        of = out / "rows" / point.scene / str(METHODS[method].mean_of) / REFUSED
        if of.exists():
            write_json(out / "rows" / point.scene / method / REFUSED, read_json(of))
            continue
        try:
            chain(scene, out / "work" / point.scene)
            seeds = seeds_of(point, method, most)
            rows = out / "rows"
            measure(method, folder, out / "work", seeds, rows, rows, keep=out / "draws")
        except InputError as refusal:
            if METHODS[method].mean_of:  # not of the scene: draws are missing
                raise
            reason = {"scene": point.scene, "method": method, "refused": refusal.what}
            write_json(out / "rows" / point.scene / method / REFUSED, reason)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--size", default="S")
    parser.add_argument("--base", default=BASE)
    parser.add_argument("--knob", required=True)
    parser.add_argument("--value", type=float, required=True)
    parser.add_argument("--methods", required=True, help="names, with commas between")
    parser.add_argument("--draws", type=int, help="most draws of the point; none: all")
    parser.add_argument("--out", type=Path, required=True)
    args = parser.parse_args()
    knob_named(args.knob)
    methods = methods_named(args.methods.split(","))
    set_threads(1)
    run(Point(args.size, args.base, args.knob, args.value), methods, args.out, args.draws)


if __name__ == "__main__":
    run_stage(main)
