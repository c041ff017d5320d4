"""The stability suite: turns one knob after the other from harmless to hard, and says where each
method breaks.

python -m benchmarks.stability --size XS --methods map --out FOLDER    # every knob's ends, minutes
python -m benchmarks.stability --out FOLDER                            # everything, hours
python -m benchmarks.stability --out FOLDER --gather rows.json         # from the rows at hand

FOLDER gets scenes/, work/ (the stages up to the fit) and rows/, one JSON file a draw; what is there
is not made again, so an interrupted run goes on where it stopped. --part 1/2 and --part 2/2 take
every second point, for two runs at a time on one folder. A point that fails leaves its message in
rows/<scene>/<method>/failed.txt and is tried again by the next run; the exit status is 1 then.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from pathlib import Path

from benchmarks.scenes import ROOT
from benchmarks.stability.gather import gathered
from benchmarks.stability.knobs import KNOBS
from benchmarks.stability.point import done
from benchmarks.stability.points import Point, points_of
from benchmarks.stability.scenes import BASE
from benchmarks.study.methods import methods_named
from pipeline.base.errors import InputError, run_stage
from pipeline.base.files import write_json
from pipeline.base.progress import progress

METHODS = ("preset_draft", "preset_draft_mean", "map", "dpi_paper")


def run(point: Point, methods: list[str], out: Path, most: int | None) -> bool:
    """Rows of a point, `most` draws of it (none: all), in a process of its own; whether they are
    there.
    """
    due = [method for method in methods if not done(point, method, out, most)]
    if not due:
        return True
    command = [sys.executable, "-m", "benchmarks.stability.point", "--size", point.size]
    command += ["--base", point.base, "--knob", point.knob, f"--value={point.value:g}"]
    command += ["--methods", ",".join(due), "--out", str(out.resolve())]
    command += [] if most is None else ["--draws", str(most)]
    ended = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    for method in due:
        failed = out / "rows" / point.scene / method / "failed.txt"
        failed.unlink(missing_ok=True)
        if ended.returncode and not done(point, method, out, most):
            failed.parent.mkdir(parents=True, exist_ok=True)
            failed.write_text(ended.stderr[-4000:], encoding="utf-8")
            print(f"{point.scene}, {method}: failed, see {failed}", file=sys.stderr, flush=True)
    return not ended.returncode


def part_of(points: list[Point], part: str) -> list[Point]:
    """Those of part "k/n", n parts that share no scene. Raises InputError."""
    number, _, count = part.partition("/")
    if not (number.isdecimal() and count.isdecimal() and 1 <= int(number) <= int(count)):
        raise InputError(f"'{part}' is no part", "--part", "say 1/2 or 2/2, for example")
    order = list(dict.fromkeys(point.scene for point in points))
    return [p for p in points if order.index(p.scene) % int(count) == int(number) - 1]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--size", default="S", help="S, or XS: every knob's ends, small")
    parser.add_argument("--base", default=BASE)
    parser.add_argument("--knobs", default=",".join(KNOBS), help="names, with commas between")
    parser.add_argument("--methods", default=",".join(METHODS), help="names, with commas between")
    parser.add_argument("--draws", type=int, help="most draws of a point; none: as its size has")
    parser.add_argument("--part", default="1/1", help="k/n: every n-th scene, from the k-th")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--gather", type=Path, help="run nothing; JSON file for all points")
    args = parser.parse_args()
    if args.gather:
        write_json(args.gather, gathered(args.out))
        return

    methods = methods_named(args.methods.split(","))
    points = part_of(points_of(args.size, args.knobs.split(","), args.base), args.part)
    made = [run(point, methods, args.out, args.draws) for point in progress(points, "stability")]
    if not all(made):
        sys.exit(f"{made.count(False)} of {len(made)} points failed")


if __name__ == "__main__":
    run_stage(main)
