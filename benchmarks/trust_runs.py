"""Runs for `benchmarks.trust` beside those of the stability suite: of any scenes whose truth is
known.

python -m benchmarks.trust_runs --scenes SUITE/* PAIRS/* --out FOLDER
python -m benchmarks.trust --runs FOLDER --out rows.json

Each scene gets its stages up to the fit in FOLDER/work, and SEEDS draws with their rows, as a point
of the stability suite has them. What is there is not made again.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from benchmarks.stability.chain import chain
from benchmarks.study.methods import OURS, scene_for
from benchmarks.study.rows import measure
from benchmarks.trust import METHOD
from pipeline.base.errors import InputError, run_stage
from pipeline.base.progress import progress
from pipeline.base.runtime import set_threads

SEEDS = [0, 1, 2]


def run(folder: Path, out: Path) -> None:
    """Rows and draws of a scene folder with truth. Raises InputError where it has none."""
    if not (folder / "truth").is_dir():
        cure = "name scene folders that benchmarks.make_scene or benchmarks.suite made"
        raise InputError("its truth is not known", folder, cure)
    work = out / "work"
    chain(scene_for(OURS, str(folder)), work / folder.name)
    measure(METHOD, folder, work, SEEDS, out / "rows", out / "rows", keep=out / "draws")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--scenes", type=Path, nargs="+", required=True, help="scene folders")
    parser.add_argument("--out", type=Path, required=True)
    args = parser.parse_args()
    set_threads(1)
    for folder in progress(sorted(args.scenes), "scenes"):
        run(folder.resolve(), args.out)


if __name__ == "__main__":
    run_stage(main)
