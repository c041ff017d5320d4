"""The workflow in a project folder of its own, for benchmarks that run one scene many times."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import yaml

from benchmarks.scenes import ROOT, machine
from pipeline.base.errors import InputError
from pipeline.base.files import read_json

ONE_THREAD = {"OMP_NUM_THREADS": "1", "PYTHONPATH": str(ROOT)}


def run_chain(project: Path, scene: str, settings: dict, targets: list[str]) -> float:
    """Make `targets` of a scene with these settings in a project folder, one job at a time on one
    thread. Returns processor seconds of all that was started; raises InputError where it fails.
    """
    config = project / "configs" / f"{scene}.yaml"
    config.parent.mkdir(parents=True, exist_ok=True)
    config.write_text(yaml.safe_dump(settings), encoding="utf-8")
    words = [
        *(sys.executable, "-m", "snakemake", "-s", str(ROOT / "Snakefile")),
        *("--profile", str(ROOT / "profiles/default"), "--directory", str(project)),
        *("--cores", "1", *targets),
    ]
    before = os.times()
    with open(project / "run.txt", "w", encoding="utf-8") as log:
        done = subprocess.run(
            words, cwd=project, env=os.environ | ONE_THREAD, stdout=log, stderr=log
        )
    after = os.times()
    if done.returncode:
        raise InputError("the run failed", project / "run.txt", "read there why")
    spent = lambda t: t.children_user + t.children_system
    return spent(after) - spent(before)


def stage_metrics(work: Path) -> dict[str, list[dict]]:
    """What the stages of a finished scene wrote about themselves, by stage."""
    found: dict[str, list[dict]] = {}
    for file in sorted([*work.glob("*.json"), *work.glob("*/*.json"), *work.glob("*/*/*.json")]):
        stage = file.stem
        if stage not in ("export", "report") and stage not in file.parts[:-1]:
            continue
        facts = read_json(file)
        if "peak_gib" in facts:
            found.setdefault(stage, []).append(facts)
    return found


def peak_gib(metrics: dict[str, list[dict]]) -> dict[str, float]:
    """Peak memory of each stage of `stage_metrics`, in GiB: of several samples the largest."""
    return {stage: max(facts["peak_gib"] for facts in many) for stage, many in metrics.items()}


def rows_at_hand(files: list[Path], folder: Path) -> dict:
    """What --gather writes: the machine and the rows of those files that are there. Raises
    InputError where there is none in `folder`.
    """
    rows = [read_json(file) for file in files if file.exists()]
    if not rows:
        raise InputError("there are no rows", folder, "run without --gather first")
    return {"machine": machine(), "rows": rows}
