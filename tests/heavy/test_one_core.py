"""A machine with one core runs the whole toy chain: `pytest -m heavy`, about a minute.

Dr.Jit set to one thread before a scene is loaded can wait for ever, and so can Mitsuba's own EXR
files; a chain that hangs fails here by its time limit.
"""

from __future__ import annotations

import os
import subprocess

import pytest

from pipeline.usd.check import check
from tests.dag.test_dag import command, exported, project, surroundings  # noqa: F401  (fixture)

pytestmark = pytest.mark.heavy
LIMIT = 900  # seconds, many times what it takes


def test_one_core_runs_the_toy_chain(project):  # noqa: F811
    core = min(os.sched_getaffinity(0))
    done = subprocess.run(
        command(project, "--cores", "1", *exported("toy")),
        preexec_fn=lambda: os.sched_setaffinity(0, {core}),
        capture_output=True,
        text=True,
        timeout=LIMIT,
        **surroundings(project),
    )
    assert done.returncode == 0, done.stderr[-3000:]
    assert check(project / "exports" / "toy.usda") == []
    assert (project / "exports" / "toy_report.html").exists()
