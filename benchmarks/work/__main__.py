"""Seconds and memory of the whole chain against work: photos, texels, samples, triangles.

python -m benchmarks.work --out FOLDER                       # about an hour on two cores
python -m benchmarks.work --out FOLDER --gather rows.json    # from the rows at hand

Every value of every knob (knobs.py) is a run of the workflow in a project folder of its own, one
job at a time on one thread, from the photos to the export and the report. FOLDER/rows gets one file
a value; what is there is not made again. `core_seconds`: processor time of all that the run
started. `seconds`: wall time of each stage, summed over samples, by their own metrics. `peak_gib`:
of the stage that took most.
"""

from __future__ import annotations

import argparse
import shutil
from pathlib import Path

from benchmarks.chain_runs import peak_gib, rows_at_hand, run_chain, stage_metrics
from benchmarks.tables.committed import head_commit
from benchmarks.work.knobs import KNOBS, Knob
from pipeline.base.config import merge
from pipeline.base.errors import InputError, nearest, run_stage
from pipeline.base.files import write_json
from pipeline.base.progress import progress

SCENE = "work"
TARGETS = [f"exports/{SCENE}.usda", f"exports/{SCENE}_report.html"]


def row(name: str, value: int, knob: Knob, preset: str, out: Path) -> dict:
    """Run one value and say what it cost."""
    photos = knob.scene(value, out / "scenes").resolve()
    project = out / "projects" / f"{name}_{value}"
    if project.exists():  # of a run that was cut off: what it has made would not be counted
        shutil.rmtree(project)
    own = {"photos": str(photos), "preset": preset, "samples": 1}
    seconds = run_chain(project, SCENE, merge(own, knob.settings(value)), TARGETS)
    metrics = stage_metrics(project / "work" / SCENE)
    peaks = peak_gib(metrics)
    shutil.rmtree(project)
    return {
        "knob": name,
        "value": value,
        "preset": preset,
        "core_seconds": seconds,
        "seconds": {stage: sum(f["seconds"] for f in many) for stage, many in metrics.items()},
        "peak_gib_by_stage": peaks,
        "peak_gib": max(peaks.values()),
        "commit": head_commit(),
    }


def gathered(out: Path) -> dict:
    """All rows that are there, in the order of the knobs. Raises InputError where there is none."""
    files = [out / "rows" / f"{name}_{v}.json" for name, knob in KNOBS.items() for v in knob.values]
    return rows_at_hand(files, out / "rows")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--knobs", default=",".join(KNOBS), help="names, with commas between")
    parser.add_argument("--preset", default="draft")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--gather", type=Path, help="run nothing; JSON file for all rows")
    args = parser.parse_args()
    if args.gather:
        write_json(args.gather, gathered(args.out))
        return

    names = args.knobs.split(",")
    for name in names:
        if name not in KNOBS:
            raise InputError(f"there is no knob '{name}'", "--knobs", nearest(name, KNOBS))
    due = [
        (name, value)
        for name in names
        for value in KNOBS[name].values
        if not (args.out / "rows" / f"{name}_{value}.json").exists()
    ]
    for name, value in progress(due, "cost against work"):
        write_json(
            args.out / "rows" / f"{name}_{value}.json",
            row(name, value, KNOBS[name], args.preset, args.out.resolve()),
        )


if __name__ == "__main__":
    run_stage(main)
