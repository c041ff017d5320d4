"""The faults: each happens to a project of its own, after which the workflow is run again."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.corpus.judge import INPUTS
from benchmarks.faults.chain import (
    ROOT,
    SCENE,
    TIMED,
    Chain,
    hidden,
    stage_name,
    stage_of,
    wait,
)

DAY = 86400.0
HALF_WAY = f"work/{SCENE}/observe/observe.json"
REFUSED = "another run is at work"
# In what a case says of itself: the fault itself ended badly, whatever the re-run does.
NOT_WELL = ("no plain message", "a traceback", "not refused")


@dataclass
class Start:
    """What cases begin with. bare: a project with nothing run; whole: the same, complete; seconds:
    that this took.
    """

    bare: Chain
    whole: Chain
    seconds: float


Case = Callable[[Start, Path, np.random.Generator], tuple[Chain, str]]


def at_work(
    start: Start, folder: Path, random: np.random.Generator
) -> tuple[Chain, subprocess.Popen, float]:
    """A run at a random moment, even over the time that the chain takes, and that moment, seconds.

    On a machine that is less busy than when that time was taken the run may have ended before: then
    another one is begun and looked at in half the time.
    """
    moment = float(random.uniform(0.5, start.seconds))
    while True:
        shutil.rmtree(folder, ignore_errors=True)
        chain = start.bare.copy(folder)
        running = chain.start()
        begin = time.monotonic()
        while time.monotonic() - begin < moment and running.poll() is None:
            time.sleep(0.02)
        if running.poll() is None:
            return chain, running, moment
        moment /= 2


def kill_job(start: Start, folder: Path, random: np.random.Generator) -> tuple[Chain, str]:
    """kill -9 of the stage at work, or of the next one; the driver goes on and ends by itself."""
    stage, name = None, ""
    while stage is None or not name:  # after the last stage there is none
        chain, running, moment = at_work(start, folder, random)
        while (stage := stage_of(running)) is None and running.poll() is None:
            time.sleep(0.01)
        name = stage_name(stage) if stage else ""
    stage.kill()
    wait(running)
    return chain, f"{name} at {moment:.1f} s"


def kill_driver(start: Start, folder: Path, random: np.random.Generator) -> tuple[Chain, str]:
    """kill -9 of Snakemake alone: its stage is left behind at work while the next run begins."""
    chain, running, moment = at_work(start, folder, random)
    stage = stage_of(running)
    name = stage_name(stage) if stage else "no stage"
    running.kill()
    running.wait()
    return chain, f"driver during {name} at {moment:.1f} s"


def kill_all(start: Start, folder: Path, random: np.random.Generator) -> tuple[Chain, str]:
    """kill -9 of driver and stage together."""
    chain, running, moment = at_work(start, folder, random)
    stage = stage_of(running)
    name = stage_name(stage) if stage else "no stage"
    os.killpg(running.pid, signal.SIGKILL)
    running.wait()
    return chain, f"driver and {name} at {moment:.1f} s"


def damage(start: Start, folder: Path, random: np.random.Generator) -> tuple[Chain, str]:
    """A file of a complete result loses its end, or all of it, and keeps its time, as after a power
    cut whose data never reached the disk.
    """
    chain = start.whole.copy(folder)
    files = made_files(chain)
    groups = sorted({file.parent for file in files})  # so that large stages do not take all cases
    group = groups[random.integers(len(groups))]
    among = [file for file in files if file.parent == group]
    file = among[random.integers(len(among))]
    size, times = file.stat().st_size, file.stat()
    kept = int(random.integers(size)) if random.random() < 0.7 else 0
    os.truncate(file, kept)
    os.utime(file, ns=(times.st_atime_ns, times.st_mtime_ns))
    return chain, f"{file.relative_to(folder)}: {kept} of {size} bytes"


def made_files(chain: Chain) -> list[Path]:
    """Files of the stages' results that are not empty, without those of TIMED."""
    made = [*chain.work.rglob("*"), *(chain.folder / "exports").rglob("*")]
    return [
        file
        for file in sorted(made)
        if file.is_file()
        and file.suffix not in TIMED
        and not hidden(file, chain.folder)
        and file.stat().st_size
    ]


def two_drivers(start: Start, folder: Path, random: np.random.Generator) -> tuple[Chain, str]:
    """Two runs, the second begun at a random moment of the first, which one of both must refuse."""
    chain, first, moment = at_work(start, folder, random)
    second = chain.start()
    both = [wait(first), wait(second)]
    said = chain.log.read_text(errors="replace")
    refused = both.count(0) == 1 and REFUSED in said
    told = "refused" if refused else f"not refused: exit status {both}"
    return chain, f"second at {moment:.1f} s, {told}"


def two_stages(start: Start, folder: Path, random: np.random.Generator) -> tuple[Chain, str]:
    """The fit by hand, twice at once, with one folder for both results: the first is held still
    while it makes the result, until the second has ended. It has its lock once its room is there;
    the lock's file is there a moment earlier.
    """
    chain = start.whole.copy(folder)
    words = [sys.executable, "-m", "stages.fit", "--config", f"configs/{SCENE}.yaml"]
    for other in INPUTS["fit"]:
        words += [f"--{other}", f"work/{SCENE}/{other}"]
    words += ["--threads", "1", "--out", f"work/{SCENE}/fit"]
    surroundings = os.environ | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    with chain.log.open("a") as log:
        begin = lambda: subprocess.Popen(
            words, cwd=folder, env=surroundings, stdout=log, stderr=log, start_new_session=True
        )
        first = begin()
        while not (chain.work / ".partial-fit" / "new").exists() and first.poll() is None:
            time.sleep(0.005)
        if first.poll() is not None:
            raise RuntimeError("the fit was never seen at work: see the case's log")
        first.send_signal(signal.SIGSTOP)
        second = wait(begin())
        first.send_signal(signal.SIGCONT)
        ends = [wait(first), second]
    said = chain.log.read_text(errors="replace")
    told = "the second refused" if ends == [0, 2] else f"not refused: exit status {ends}"
    return chain, f"fit and fit, {'a traceback' if 'Traceback' in said else told}"


def clock_back(start: Start, folder: Path, random: np.random.Generator) -> tuple[Chain, str]:
    """Half of the chain was made, then the clock went back a day."""
    chain = start.bare.copy(folder)
    wait(chain.start("--until", "observe"))
    return chain, f"{_shift(made_files(chain), DAY)} files from tomorrow"


def clock_forth(start: Start, folder: Path, random: np.random.Generator) -> tuple[Chain, str]:
    """Half of the chain was made, then the clock went a day forth."""
    chain = start.bare.copy(folder)
    wait(chain.start("--until", "observe"))
    return chain, f"{_shift(made_files(chain), -DAY)} files from yesterday"


def photos_from_tomorrow(
    start: Start, folder: Path, random: np.random.Generator
) -> tuple[Chain, str]:
    """The camera's clock is a day ahead: refused, until the user does what the message says."""
    chain = start.bare.copy(folder)
    photos = [file for file in (folder / "photos").rglob("*") if file.is_file()]
    _shift(photos, DAY + time.time() - photos[0].stat().st_mtime)
    end = chain.run()
    plain = end.status == 1 and "from the future" in end.said and "Traceback" not in end.said
    for file in photos:
        os.utime(file)
    told = "a plain message" if plain else "no plain message"
    return chain, f"{len(photos)} files of the user's, {told}"


def _shift(files: list[Path], seconds: float) -> int:
    for file in files:
        at = file.stat().st_mtime + seconds
        os.utime(file, (at, at))
    return len(files)


def undisturbed(start: Start, folder: Path, random: np.random.Generator) -> tuple[Chain, str]:
    """Nothing happens: the control."""
    return start.bare.copy(folder), "nothing"
