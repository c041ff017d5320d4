"""Faults over the whole chain on a small project: after each of them the workflow is run again, and
must end with the same bytes as where nothing happened, with nothing left to do.

python -m benchmarks.faults --folder FOLDER --out rows.json [--count 10] [--only TEXT]

Faults: kill -9 of a job, of the driver, of both, at random moments; files that lose their end; two
runs at once; clocks that jump; a disk that gets full in each stage. --count: cases of each random
kind. A case that has its row in FOLDER is not run again, nor one that another process of this
command is at, and --out is written after each case: it holds all rows of FOLDER, whichever process
has made them. One thread; one to three minutes a case.
"""

from __future__ import annotations

import argparse
import os
import shutil
import sys
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from benchmarks.corpus.mounts import NotPossible
from benchmarks.faults import cases
from benchmarks.faults.chain import Chain
from benchmarks.faults.disk import EXPORTING, ORDER, full_in
from pipeline.base.errors import run_stage
from pipeline.base.files import read_json, write_json
from pipeline.base.locks import lock

RANDOM = {
    "kill -9 of a job": cases.kill_job,
    "kill -9 of the driver alone": cases.kill_driver,
    "kill -9 of driver and job": cases.kill_all,
    "a file loses its end": cases.damage,
}
ONCE = {
    "nothing": cases.undisturbed,
    "two runs at once": cases.two_drivers,
    "one stage twice at once": cases.two_stages,
    "the clock goes a day back": cases.clock_back,
    "the clock goes a day forth": cases.clock_forth,
    "photos from tomorrow": cases.photos_from_tomorrow,
    **{f"disk full in {stage}": full_in(stage) for stage in ORDER + EXPORTING},
}


def all_cases(count: int) -> list[tuple[str, int, cases.Case]]:
    """Kind, number and function of every case."""
    often = [(kind, n, case) for n in range(count) for kind, case in RANDOM.items()]
    return [(kind, 0, case) for kind, case in ONCE.items()] + often


def begin(folder: Path) -> cases.Start:
    """The projects that cases begin with, made where they are not there yet."""
    bare, whole, facts = folder / "bare", folder / "whole", folder / "whole.json"
    if not facts.exists():
        for old in (bare, whole):
            shutil.rmtree(old, ignore_errors=True)
        Chain(bare).make()
        end = Chain(bare).copy(whole).run()
        if end.status != 0:
            raise RuntimeError(f"the undisturbed run failed:\n{end.said[-3000:]}")
        write_json(facts, {"seconds": end.seconds})
    return cases.Start(Chain(bare), Chain(whole), read_json(facts)["seconds"])


def judge(chain: Chain, wanted: dict[str, str]) -> dict:
    """Run the workflow again, and say what came of it. RuntimeError where somebody has ended it."""
    end = chain.run()
    if end.status is not None and end.status < 0:
        raise RuntimeError(f"the re-run was ended from outside, by signal {-end.status}")
    found = chain.sums()
    differ = sorted(k for k in wanted.keys() | found.keys() if wanted.get(k) != found.get(k))
    due = chain.due()
    wrong = [
        (end.status != 0, f"the re-run ended with {end.status}"),
        ("Traceback" in end.said, "a traceback"),
        (bool(differ), f"other bytes: {differ[:4]}"),
        (bool(chain.leftovers()), f"left behind: {chain.leftovers()}"),
        (bool(due), f"due again: {due}"),
    ]
    said = [text for is_so, text in wrong if is_so]
    return {"seconds": round(end.seconds, 1), "right": not said, "wrong": "; ".join(said)}


def tell(kind: str, number: int, case: cases.Case, start: cases.Start, folder: Path) -> dict:
    """One case from its beginning to its row."""
    shutil.rmtree(folder, ignore_errors=True)
    random = np.random.default_rng([number, zlib.crc32(kind.encode())])
    row = {"fault": kind, "number": number}
    try:
        chain, happened = case(start, folder, random)
    except NotPossible as error:
        return row | {"tried": False, "happened": f"not tried: {error}"}
    row |= {"tried": True, "happened": happened} | judge(chain, start.whole.sums())
    if row["right"] and any(text in happened for text in cases.NOT_WELL):
        row |= {"right": False, "wrong": happened}
    return row


def in_a_child(
    kind: str, number: int, case: cases.Case, start: cases.Start, folder: Path
) -> dict | None:
    """As `tell`, in a process that may enter a name space; None where the case itself failed."""
    file = folder.with_suffix(".json")
    child = os.fork()
    if child == 0:
        status = 1
        try:
            write_json(file, tell(kind, number, case, start, folder))
            status = 0
        except BaseException:
            sys.excepthook(*sys.exc_info())
        finally:
            sys.stdout.flush()
            os._exit(status)
    _, status = os.waitpid(child, 0)
    return None if status else read_json(file)


def place_of(folder: Path, kind: str, number: int) -> Path:
    """The project of a case; its row is beside it."""
    return folder / f"{kind.replace(' ', '_')}_{number}"


@contextmanager
def by_itself(folder: Path) -> Iterator[bool]:
    """Whether no other process is at the case of this folder; if so, none is meanwhile."""
    try:
        held = lock(folder.with_suffix(".lock"))
    except BlockingIOError:
        yield False
        return
    with held:
        yield True


def gather(folder: Path, out: Path, count: int, seconds: float) -> list[dict]:
    """Write the rows of all cases that have one, and return them."""
    files = [place_of(folder, kind, n).with_suffix(".json") for kind, n, _ in all_cases(count)]
    rows = [read_json(file) for file in files if file.exists()]
    write_json(out, {"seconds_undisturbed": round(seconds, 1), "rows": rows})
    return rows


def said(row: dict) -> str:
    """A row as a line."""
    if not row["tried"]:
        return row["happened"]
    mark = "right" if row["right"] else f"WRONG: {row['wrong']}"
    return f"{row['happened']}, {row['seconds']} s, {mark}"


def _run() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--folder", type=Path, required=True, help="for projects and rows")
    parser.add_argument("--out", type=Path, required=True, help="JSON file for all rows")
    parser.add_argument("--count", type=int, default=10, help="cases of each random kind")
    parser.add_argument("--only", default="", help="kinds that have this text")
    args = parser.parse_args()

    top = args.folder.resolve()
    top.mkdir(parents=True, exist_ok=True)
    with lock(top / "begin.lock", wait=True):
        start = begin(top)
    failed = 0
    for kind, number, case in all_cases(args.count):
        if args.only not in kind:
            continue
        folder = place_of(top, kind, number)
        with by_itself(folder) as mine:
            if not mine or folder.with_suffix(".json").exists():
                continue
            row = in_a_child(kind, number, case, start, folder)
            if row is None:
                failed += 1
                continue
            print(f"{kind} {number}: {said(row)}", flush=True)
            if not row["tried"] or row["right"]:
                shutil.rmtree(folder, ignore_errors=True)
            gather(top, args.out, args.count, start.seconds)

    rows = [row for row in gather(top, args.out, args.count, start.seconds) if row["tried"]]
    right = sum(row["right"] for row in rows)
    print(f"{len(rows)} faults, {right} right; {failed} cases failed by themselves")
    sys.exit(1 if right < len(rows) or failed else 0)


if __name__ == "__main__":
    run_stage(_run)
