"""The comparative study: makes a suite, runs every method on every scene, and keeps the rows.

python -m benchmarks.study --suite XS --methods split_gibbs_draft,map --out FOLDER
python -m benchmarks.study --suite XS --tables
python -m benchmarks.study --suite pairs --given SCENES --out FOLDER

ROWS/<suite>/<scene>/<method> gets one JSON file for each seed (benchmarks/study/store.py); ROWS are
the committed rows unless --rows says another folder. What is there is not made again, so that an
interrupted study goes on where it stopped, rows of several machines are added up by copying or
committing them, and all rows are made anew with --rows naming an empty folder.

FOLDER/scenes gets the suite, FOLDER/draws the pictures of which figures of several draws are made.
With --given the scenes are those in SCENES, which benchmarks.pairs or benchmarks.make_scene made.
Stages up to the fit, which all methods share, lie in work/<scene>; they are made once, and used as
they lie there. A method that fails leaves its message in FOLDER/draws/<scene>/<method>/failed.txt
and is tried again by the next run; the exit status is 1 then. --tables prints the tables with
intervals from the rows at hand.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path

from benchmarks.scenes import AS_CONFIGURED, ROOT, snakemake
from benchmarks.study import scenes
from benchmarks.study.methods import METHODS, methods_named
from benchmarks.study.store import ROWS, row_file, suite_folder, suite_rows
from benchmarks.study.tables import printed
from benchmarks.study.together import join
from pipeline.base.errors import InputError, run_stage
from pipeline.base.progress import progress


def prepare(folder: Path) -> None:
    """The stages of a scene up to the fit, where they are not there."""
    work = ROOT / "work" / folder.name
    if not (work / "fit" / "fit.json").exists():
        targets = [f"work/{folder.name}/{s}/{s}.json" for s in ("fit", "mesh")]
        snakemake(folder, targets, ["preset=draft", AS_CONFIGURED])


def run(folder: Path, method: str, seeds: range, rows: Path, draws: Path, about: dict) -> bool:
    """Rows of a method on a scene, in a process of its own; whether all are there. A method that
    draws nothing has one, of the first seed.
    """
    seeds = seeds if METHODS[method].drawn else seeds[:1]
    if all(row_file(rows, folder.name, method, seed).exists() for seed in seeds):
        return True
    command = [sys.executable, "-m", "benchmarks.study.rows", "--photos", str(folder)]
    command += ["--method", method, "--work", str(ROOT / "work")]
    command += ["--rows", str(rows.resolve()), "--draws", str(draws.resolve())]
    command += ["--about", json.dumps(about), "--seeds", *map(str, seeds)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    failed = draws / folder.name / method / "failed.txt"
    failed.unlink(missing_ok=True)
    if done.returncode:
        failed.parent.mkdir(parents=True, exist_ok=True)
        failed.write_text(done.stderr[-4000:], encoding="utf-8")
        print(f"{folder.name}, {method}: failed, see {failed}", file=sys.stderr, flush=True)
    return not done.returncode


def said(args: argparse.Namespace) -> str:
    """The command as rows say it: with FOLDER for the folder of this machine."""
    given = [scenes.said(args)]
    given += [f"--scenes {args.scenes}"] if args.scenes else []
    given += [f"--methods {args.methods}"] if args.methods else []
    given += [f"--samples {args.samples}"]
    given += [f"--first-seed {args.first_seed}"] if args.first_seed else []
    return f"python -m benchmarks.study {' '.join(given)} --out FOLDER"


def study(args: argparse.Namespace) -> None:
    """Make the rows that are not there. Raises SystemExit where a method failed, and InputError
    where the mean of other draws than the first is asked for.
    """
    methods = methods_named(args.methods.split(",")) if args.methods else list(METHODS)
    means = [method for method in methods if METHODS[method].mean_of]
    if args.first_seed and means:
        cure = "leave it out, or name other --methods"
        raise InputError(f"{', '.join(means)}: of the draws from 0 on", "--first-seed", cure)
    seeds = range(args.first_seed, args.first_seed + args.samples)
    only = args.scenes.split(",") if args.scenes else None
    folders = scenes.scenes_of(args.suite, args.out / "scenes", args.given, only)
    for folder in folders:
        prepare(folder)

    rows, draws = suite_folder(args.rows, args.suite), args.out / "draws"
    about = {"suite": args.suite, "command": said(args), "note": args.note}
    jobs = [(folder, method) for method in methods for folder in folders]
    made = []
    for folder, method in progress(jobs, "study"):
        made.append(run(folder, method, seeds, rows, draws, about))
        join(folder, method, rows, draws, about)
    if not all(made):
        sys.exit(f"{made.count(False)} of {len(made)} methods on scenes failed")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    scenes.add_options(parser)
    parser.add_argument("--scenes", help="names, with commas between; all if not given")
    parser.add_argument("--methods", help="names, with commas between; all if not given")
    parser.add_argument("--samples", type=int, default=3, help="draws of each method")
    parser.add_argument(
        "--first-seed", type=int, default=0, help="the draws' seeds: this and those that follow"
    )
    parser.add_argument("--rows", type=Path, default=ROWS, help="the committed ones if not given")
    parser.add_argument("--note", default="", help="what rows say besides: other jobs, say")
    what = parser.add_mutually_exclusive_group(required=True)
    what.add_argument("--out", type=Path, help="folder for scenes and pictures")
    what.add_argument("--tables", action="store_true", help="run nothing; print the tables")
    args = parser.parse_args()
    if args.tables:
        print(printed(suite_rows(args.suite, args.rows)))
    else:
        study(args)


if __name__ == "__main__":
    run_stage(main)
