"""The comparative study: makes a suite, runs every method on every scene, and gathers the rows.

python -m benchmarks.study --suite XS --methods split_gibbs_draft,map --out FOLDER
python -m benchmarks.study --suite XS --out FOLDER --tables

FOLDER/scenes gets the suite, FOLDER/rows one JSON file for each scene, method and seed; what is
there is not made again, so an interrupted study goes on where it stopped. Stages up to the fit,
which all methods share, lie in work/<scene>; they are made once, and used as they lie there.
A method that fails leaves its message in FOLDER/rows/<scene>/<method>/failed.txt and is tried again
by the next run; the exit status is 1 then. --tables prints the tables with intervals from the rows
at hand, and --gather FILE writes rows and figures of several draws into one file for
benchmarks.tables.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from pathlib import Path

from benchmarks.scenes import ROOT, snakemake
from benchmarks.study.gather import gathered
from benchmarks.study.methods import METHODS, methods_named
from benchmarks.study.tables import printed
from benchmarks.suite.make import make_suite
from pipeline.base.errors import run_stage
from pipeline.base.files import write_json
from pipeline.base.progress import progress


def prepare(folder: Path) -> None:
    """The stages of a scene up to the fit, where they are not there."""
    work = ROOT / "work" / folder.name
    if not (work / "fit" / "fit.json").exists():
        targets = [f"work/{folder.name}/{s}/{s}.json" for s in ("fit", "mesh")]
        snakemake(folder, targets, ["preset=draft"])


def run(folder: Path, method: str, samples: int, out: Path) -> bool:
    """Rows of a method on a scene, in a process of its own; whether all are there."""
    seeds = range(samples if METHODS[method].drawn else 1)
    rows = out / "rows" / folder.name / method
    if all((rows / f"{seed}.json").exists() for seed in seeds):
        return True
    command = [sys.executable, "-m", "benchmarks.study.rows", "--photos", str(folder)]
    command += ["--method", method, "--work", str(ROOT / "work"), "--out", str(out / "rows")]
    command += ["--seeds", *map(str, seeds)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    failed = rows / "failed.txt"
    failed.unlink(missing_ok=True)
    if done.returncode:
        rows.mkdir(parents=True, exist_ok=True)
        failed.write_text(done.stderr[-4000:], encoding="utf-8")
        print(f"{folder.name}, {method}: failed, see {failed}", file=sys.stderr, flush=True)
    return not done.returncode


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--suite", default="XS")
    parser.add_argument("--scenes", help="names, with commas between; all if not given")
    parser.add_argument("--methods", default=",".join(METHODS), help="names, with commas between")
    parser.add_argument("--samples", type=int, default=3, help="draws of each method")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--tables", action="store_true", help="run nothing; print the tables")
    parser.add_argument("--gather", type=Path, help="run nothing; JSON file for all rows")
    args = parser.parse_args()

    if args.tables or args.gather:
        found = gathered(args.out)
        if args.gather:
            write_json(args.gather, found)
        if args.tables:
            print(printed(found))
        return

    methods = methods_named(args.methods.split(","))
    only = args.scenes.split(",") if args.scenes else None
    scenes = [folder.resolve() for folder in make_suite(args.suite, args.out / "scenes", only)]
    for folder in scenes:
        prepare(folder)
    jobs = [(folder, method) for method in methods for folder in scenes]
    made = [run(folder, m, args.samples, args.out) for folder, m in progress(jobs, "study")]
    if not all(made):
        sys.exit(f"{made.count(False)} of {len(made)} methods on scenes failed")


if __name__ == "__main__":
    run_stage(main)
