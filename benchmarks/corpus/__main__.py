"""The corpus of bad input: every case ends in a right result or in one message that names file,
fact and cure; no traceback, no hang, nothing of the user's lost.

python -m benchmarks.corpus --out rows.json [--heavy] [--only TEXT] [--keep FOLDER]
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

from benchmarks.corpus.case import CASES, Case
from benchmarks.corpus.judge import judge
from pipeline.base import runtime
from pipeline.base.errors import run_stage
from pipeline.base.files import write_json


def load_cases() -> list[Case]:
    """All cases, in the order of their groups."""
    from benchmarks.corpus import (  # noqa: F401
        cameras,
        masks,
        meshes,
        models,
        names,
        photos,
        settings,
        surroundings,
    )

    return CASES


def judge_all(cases: list[Case], folder: Path) -> list[dict]:
    """A row for each case; their projects stay in `folder`."""
    rows = []
    for number, case in enumerate(cases):
        row = judge(case, folder / f"{number:03d}")
        untried = row["happened"] == "not tried"
        mark = "" if untried else "right" if row["right"] else f"WRONG: {row['wrong']}"
        print(f"{case.group}: {case.name}: {row['happened']}, {row['seconds']} s, {mark}")
        if not row["right"]:
            print(f"    {row['said']}")
        sys.stdout.flush()
        rows.append(row)
    return rows


def _run() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, required=True, help="JSON file for the rows")
    parser.add_argument("--heavy", action="store_true", help="the expensive cases too")
    parser.add_argument("--only", default="", help="cases whose group or name has this text")
    parser.add_argument("--keep", type=Path, help="folder to keep the cases' projects in")
    args = parser.parse_args()

    runtime.set_threads(1)
    cases = [c for c in load_cases() if args.only in f"{c.group}: {c.name}"]
    cases = [c for c in cases if args.heavy or not c.heavy]
    with tempfile.TemporaryDirectory(prefix="heliograph-corpus-") as temporary:
        rows = judge_all(cases, args.keep or Path(temporary))
    wrong = sum(not row["right"] for row in rows)
    untried = sum(row["happened"] == "not tried" for row in rows)
    print(f"{len(rows)} cases, {len(rows) - wrong - untried} right, {untried} not to be tried here")
    write_json(args.out, {"rows": rows})
    sys.exit(1 if wrong else 0)


if __name__ == "__main__":
    run_stage(_run)
