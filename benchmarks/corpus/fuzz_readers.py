"""Fuzz of the readers: good files changed at random. A reader must take one, as something right,
or refuse it by an InputError with a place and a cure; anything else, be it a crash or a hang, is a
find.

python -m benchmarks.corpus.fuzz_readers --seconds 600 --out finds.json
python -m benchmarks.corpus.fuzz_readers --replay mesh 1234

Input `number` of a reader is the same bytes on every machine: the generator's seed is (SEED, the
reader's place in READERS, number).
"""

from __future__ import annotations

import argparse
import faulthandler
import json
import mmap
import os
import resource
import signal
import struct
import sys
import tempfile
import time
import traceback
from collections import Counter
from pathlib import Path

import numpy as np
import yaml

from benchmarks.corpus.mutate import mutated_bytes, mutated_text, mutated_tree
from benchmarks.corpus.readers import READERS, Reader, Seed
from benchmarks.scenes import machine
from pipeline.base import runtime
from pipeline.base.errors import InputError, run_stage
from pipeline.base.files import read_json, write_json

SEED = 20261123
LIMIT = 60.0  # seconds that a reader may take for one small file, on a busy machine
MEMORY = 12 * 2**30  # bytes of address space
ROOT = Path(__file__).resolve().parents[2]
EVERY = 2**62


def changed(reader: Reader, seeds: list[Seed], number: int) -> dict[str, bytes]:
    """The files, path -> bytes, of an input of a reader."""
    rng = np.random.default_rng([SEED, READERS.index(reader), number])
    seed = seeds[rng.integers(len(seeds))]
    other = seeds[rng.integers(len(seeds))]
    data = seed.files[seed.spoil]
    way = rng.random()
    if seed.kind == "json" and way < 0.5:
        data = json.dumps(mutated_tree(json.loads(data), rng)).encode()
    elif seed.kind == "yaml" and way < 0.5:
        tree = mutated_tree(yaml.safe_load(data), rng)
        data = yaml.safe_dump(tree, allow_unicode=True).encode("utf-8", "surrogatepass")
    elif seed.kind != "bytes" and way < 0.85:
        data = mutated_text(data.decode(), rng).encode("utf-8", "surrogatepass")
    else:
        data = mutated_bytes(data, other.files[other.spoil], rng)
    return seed.files | {seed.spoil: data}


def put(files: dict[str, bytes], folder: Path) -> None:
    """Write files into a new folder."""
    for name, data in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(data)


def fault(error: BaseException) -> str:
    """What is wrong with how a reader ended, empty where nothing is: kind of the error, and the
    last place in the project's own code.
    """
    if isinstance(error, InputError):
        return (
            "" if error.where and error.cure else f"a message without place or cure: {error.what}"
        )
    frames = [
        f for f in traceback.extract_tb(error.__traceback__) if f.filename.startswith(str(ROOT))
    ]
    own = [f for f in frames if ".venv" not in f.filename]
    last = own[-1]
    text = str(error).splitlines()[0][:120] if str(error) else ""
    return f"{type(error).__name__} in {Path(last.filename).name}, {last.name}: {text}"


def tried(reader: Reader, files: dict[str, bytes]) -> tuple[bool, str]:
    """Whether a reader took the files, and what is wrong with how it ended."""
    with tempfile.TemporaryDirectory(prefix="input-", dir=os.curdir) as name:
        folder = Path(name).resolve()
        put(files, folder)
        try:
            reader.read(folder)
        except Exception as error:  # whatever it is, it is judged
            return False, fault(error)
    return True, ""


class Worker:
    """A process of its own that tries inputs from `first` on, until `last` or the deadline: native
    readers may crash or hang. Its counts lie in memory that both processes see: the input at work
    and the time it was begun, how many were tried and how many taken.
    """

    FORM = struct.Struct("<qdqq")

    def __init__(self, reader: Reader, seeds: list[Seed], folder: Path):
        self.reader, self.seeds, self.folder = reader, seeds, folder
        self.shared = mmap.mmap(-1, self.FORM.size)
        self.finds = folder / "finds.jsonl"

    def counts(self) -> tuple[int, float, int, int]:
        return self.FORM.unpack(self.shared[: self.FORM.size])

    def run(self, first: int, last: int, deadline: float) -> str:
        """Try inputs; what ended the process early, empty where it came to its end."""
        _, _, done, taken = self.counts()
        self.shared[: self.FORM.size] = self.FORM.pack(first, time.monotonic(), done, taken)
        child = os.fork()
        if child == 0:
            self._become(first, last, deadline, done, taken)

        while True:
            found, status = os.waitpid(child, os.WNOHANG)
            if found:
                code = os.waitstatus_to_exitcode(status)
                return "" if code == 0 else _ending(code)
            if time.monotonic() - self.counts()[1] > LIMIT:
                os.kill(child, signal.SIGKILL)
                os.waitpid(child, 0)
                return f"no end after {LIMIT:g} s"
            time.sleep(0.02)

    def _become(self, first: int, last: int, deadline: float, done: int, taken: int) -> None:
        """In the child. Does not return."""
        status = 1
        try:
            faulthandler.disable()  # the parent reports a crash
            os.chdir(self.folder)
            log = os.open("log.txt", os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
            os.dup2(log, 1)
            os.dup2(log, 2)
            resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
            resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
            for number in range(first, last):
                if time.monotonic() > deadline:
                    break
                now = self.FORM.pack(number, time.monotonic(), done, taken)
                self.shared[: self.FORM.size] = now
                took, wrong = tried(self.reader, changed(self.reader, self.seeds, number))
                done += 1
                taken += took
                if wrong:
                    with self.finds.open("a", encoding="utf-8") as file:
                        file.write(json.dumps({"number": number, "what": wrong}) + "\n")
            self.shared[: self.FORM.size] = self.FORM.pack(last, time.monotonic(), done, taken)
            status = 0
        except BaseException:  # into the log, and the parent stops
            traceback.print_exc()
        finally:
            os._exit(status)


def _ending(code: int) -> str:
    return f"crash by {signal.Signals(-code).name}" if code < 0 else f"exit status {code}"


def fuzz(reader: Reader, seconds: float, count: int = EVERY, begin: int = 0) -> dict:
    """Try inputs of a reader from number `begin` on, for some seconds, at most `count`: a row of
    the table.

    finds: what -> how often, and the first input that showed it. RuntimeError where the fuzz itself
    fails.
    """
    start = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="heliograph-fuzz-") as name:
        worker = Worker(reader, reader.seeds(), Path(name))
        finds: list[dict] = []
        first = begin
        while first < begin + count and time.monotonic() - start < seconds:
            ended = worker.run(first, begin + count, start + seconds)
            if not ended:
                break
            if ended.startswith("exit"):
                raise RuntimeError((Path(name) / "log.txt").read_text(errors="replace"))
            number = worker.counts()[0]
            finds.append({"number": number, "what": ended})
            first = number + 1
        if worker.finds.exists():
            finds += [json.loads(line) for line in worker.finds.read_text("utf-8").splitlines()]
        _, _, done, taken = worker.counts()

    return {
        "reader": reader.name,
        "inputs": done + sum("crash" in f["what"] or "no end" in f["what"] for f in finds),
        "taken": taken,
        "seconds": round(time.monotonic() - start, 1),
        "finds": _gathered(finds),
    }


def _gathered(finds: list[dict]) -> list[dict]:
    """One entry for all finds that say the same."""
    often = Counter(find["what"] for find in finds)
    first = {find["what"]: find["number"] for find in sorted(finds, key=lambda f: -f["number"])}
    return [{"what": what, "times": n, "first": first[what]} for what, n in often.most_common()]


def _with_kept(rows: list[dict], out: Path) -> list[dict]:
    """New rows, and those of other readers that a file of an earlier run holds, in their order."""
    kept = {row["reader"]: row for row in read_json(out)["rows"]} if out.exists() else {}
    kept |= {row["reader"]: row for row in rows}
    return [kept[reader.name] for reader in READERS if reader.name in kept]


def replay(name: str, number: int) -> None:
    """Try one input in this process, and let its error through."""
    reader = next(r for r in READERS if r.name == name)
    with tempfile.TemporaryDirectory(prefix="heliograph-fuzz-") as folder:
        put(changed(reader, reader.seeds(), number), Path(folder))
        reader.read(Path(folder))


def _run() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seconds", type=float, default=60, help="for all readers together")
    parser.add_argument("--count", type=int, default=EVERY, help="at most, for each reader")
    parser.add_argument("--first", type=int, default=0, help="number of the first input")
    parser.add_argument("--only", default="", help="readers whose name has this text")
    parser.add_argument("--out", type=Path, help="JSON file for the rows; those of others stay")
    parser.add_argument("--replay", nargs=2, metavar=("READER", "NUMBER"))
    args = parser.parse_args()
    runtime.set_threads(1)
    if args.replay:
        replay(args.replay[0], int(args.replay[1]))
        return

    readers = [r for r in READERS if args.only in r.name]
    rows = []
    for reader in readers:
        row = fuzz(reader, args.seconds / len(readers), args.count, args.first)
        print(f"{row['reader']}: {row['inputs']} inputs, {row['taken']} taken, {row['seconds']} s")
        for find in row["finds"]:
            print(f"    {find['times']} x {find['what']} (first: {find['first']})")
        sys.stdout.flush()
        rows.append(row)
    if args.out:
        write_json(args.out, {"machine": machine(), "rows": _with_kept(rows, args.out)})
    sys.exit(1 if any(row["finds"] for row in rows) else 0)


if __name__ == "__main__":
    run_stage(_run)
