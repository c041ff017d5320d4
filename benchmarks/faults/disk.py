"""A disk that gets full in the middle of the chain, in a mount name space of a child's own."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np

from benchmarks.corpus.mounts import full
from benchmarks.faults.cases import Start
from benchmarks.faults.chain import SCENE, Chain

ORDER = ("capture", "poses", "masks", "mesh", "atlas", "observe", "fit", "sample", "refine")
EXPORTING = ("export", "report")  # these write into exports/
DISK = 1 << 16  # KiB
LEFT = 12 << 10  # bytes that the stage finds free: less than any result
FULL = "full"  # what the message must say


def fill(folder: Path) -> Path:
    """Take the room of the disk on which `folder` lies, all but LEFT bytes; the file that does."""
    free = os.statvfs(folder)
    filler = folder / "filler"
    with filler.open("wb") as file:
        os.posix_fallocate(file.fileno(), 0, free.f_bavail * free.f_frsize - LEFT)
    return filler


def full_in(stage: str) -> Callable[[Start, Path, np.random.Generator], tuple[Chain, str]]:
    """The case of a disk that is full when `stage` begins. Must be called in a process that may
    end with it: it enters a name space of its own.
    """

    place = "exports" if stage in EXPORTING else "work"

    def case(start: Start, folder: Path, random: np.random.Generator) -> tuple[Chain, str]:
        chain = start.whole.copy(folder)
        (folder / place).rename(folder / "kept")
        full(str(folder / place), DISK)()
        shutil.copytree(folder / "kept", folder / place, dirs_exist_ok=True)
        undo(chain, stage)

        filler = fill(folder / place)
        end = chain.run()
        filler.unlink()
        plain = FULL in end.said and "Traceback" not in end.said
        told = "a plain message" if plain else "no plain message"
        return chain, f"{place}, {stage}: exit status {end.status}, {told}"

    return case


def undo(chain: Chain, stage: str) -> None:
    """Remove what `stage` and those after it have made."""
    if stage in ORDER:
        for later in ORDER[ORDER.index(stage) :]:
            shutil.rmtree(chain.work / later)
    if stage != "report":
        shutil.rmtree(chain.folder / "exports" / SCENE)
        (chain.folder / "exports" / f"{SCENE}.usda").unlink()
    (chain.folder / "exports" / f"{SCENE}_report.html").unlink()
