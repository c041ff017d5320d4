"""Scores anew from the pictures of draws, where a metric has changed since rows were made.

python -m benchmarks.study.rescore --suite S --out FOLDER

A draw takes longer to make than to score, and its pictures lie in FOLDER/draws of the study that
made it. Every row whose pictures lie there gets the scores of ANEW by the code at hand, and says by
which commit under `rescored`; all else in it stays. A row is left as it is, and a line on stderr
says so, where its pictures are missing, or show another draw than its relight PSNR is of.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

from benchmarks.study import scenes
from benchmarks.study.store import ROWS, places_in, seeds_in, suite_folder
from benchmarks.study.together import scored, truth_of_row
from benchmarks.tables.committed import head_commit
from pipeline.base.errors import run_stage
from pipeline.base.files import read_json, write_json
from pipeline.base.progress import progress
from pipeline.report.score import aligned_psnr, relight_psnr

ANEW = {"relight_psnr_channel": aligned_psnr}
SAME = 0.02  # dB by which kept pictures, of half precision, may score unlike those they were


def rescore(file: Path, pack: Path, folder: Path, commit: str) -> str | None:
    """Write a row's scores of ANEW from the pictures in `pack`; or why it is left as it is. folder:
    the scene's.
    """
    if not pack.exists():
        return f"there is no {pack}"
    row = read_json(file)
    truth = truth_of_row(folder, row)
    with np.load(pack) as kept:
        pictures = scored(kept).pictures
    off = relight_psnr(pictures, truth) - row["scores"]["relight_psnr"]
    if abs(off) > SAME:
        return f"{pack} is of another draw, by {abs(off):.2f} dB of relight PSNR"
    scores = {name: score(pictures, truth) for name, score in ANEW.items()}
    said = row.get("rescored", {}) | dict.fromkeys(scores, commit)
    write_json(file, row | {"scores": row["scores"] | scores, "rescored": said})
    return None


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    scenes.add_options(parser)
    parser.add_argument("--rows", type=Path, default=ROWS, help="the committed ones if not given")
    parser.add_argument("--out", type=Path, required=True, help="folder of scenes and pictures")
    args = parser.parse_args()

    rows, commit = suite_folder(args.rows, args.suite), head_commit()
    folders = {f.name: f for f in scenes.scenes_of(args.suite, args.out / "scenes", args.given)}
    jobs = [(place, seed) for place in places_in(rows) for seed in seeds_in(place)]
    for place, seed in progress(jobs, "rescore"):
        scene = place.parent.name
        pack = args.out / "draws" / scene / place.name / f"{seed}.npz"
        why = rescore(place / f"{seed}.json", pack, folders[scene], commit)
        if why:
            print(f"{scene}, {place.name}, {seed}: left as it is, {why}", file=sys.stderr)


if __name__ == "__main__":
    run_stage(main)
