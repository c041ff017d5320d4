"""Every kind of bad input ends in a right result or in one message (benchmarks.corpus)."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks.corpus.__main__ import load_cases

ROOT = Path(__file__).resolve().parents[2]
GROUPS = sorted({case.group for case in load_cases()})
RENDERED = ("mesh", "machine")  # their stages load the renderer, seconds each: tests/heavy


def all_end_well(group: str, tmp_path: Path) -> None:
    """Run a group of cases in a process of its own."""
    out = tmp_path / "rows.json"
    words = ["--only", f"{group}: ", "--out", str(out), "--keep", str(tmp_path / "projects")]
    command = [sys.executable, "-m", "benchmarks.corpus", *words]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-2000:]
    rows = json.loads(out.read_text())["rows"]
    assert rows and all(row["right"] for row in rows)


@pytest.mark.slow
@pytest.mark.parametrize("group", [group for group in GROUPS if group not in RENDERED])
def test_bad_input_ends_well(group, tmp_path):
    all_end_well(group, tmp_path)


def test_no_case_may_write_outside_of_its_project(tmp_path):
    """One that did would let a defect delete what is there."""
    from benchmarks.corpus.judge import stay_inside
    from benchmarks.corpus.project import Project

    project = Project(tmp_path / "p")
    stay_inside(project, ["--out", "work/s/capture"])
    for out in ("..", "/", "work/../../elsewhere"):
        with pytest.raises(ValueError, match="leaves"):
            stay_inside(project, ["--out", out])


@pytest.mark.slow
def test_mutated_files_end_well(tmp_path):
    """A few seeds; `python -m benchmarks.corpus.fuzz` tries more."""
    out = tmp_path / "fuzz.json"
    command = [sys.executable, "-m", "benchmarks.corpus.fuzz", "--tries", "12", "--out", str(out)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-2000:]
    found = json.loads(out.read_text())
    assert found["tries"] == 12 and not found["finds"], found["finds"]
