"""Files from the future: a camera's clock or time zone is wrong, or this machine's has gone back.

Snakemake refuses a result that is older than what it was made from, and speaks of the network.
"""

from __future__ import annotations

import os
import sys
import time
from datetime import timedelta
from pathlib import Path

from pipeline.base.errors import InputError

SKEW = 1.0  # seconds by which clocks may differ


def not_from_the_future(files: list[Path]) -> list[str]:
    """The paths of the user's files. InputError for one that is newer than now."""
    for file in files:
        ahead = file.stat().st_mtime - time.time() if file.exists() else 0.0
        if ahead > SKEW:
            raise InputError(
                f"the file is from the future, by {timedelta(seconds=round(ahead))}: a clock or a "
                "time zone is wrong",
                file,
                "set this machine's clock, or give the file the time of now with `touch`",
            )
    return [str(file) for file in files]


def settle_times(folders: list[Path]) -> None:
    """Give the files in `folders` that are from the future the time of now: they were made before
    this machine's clock went back. Files among the folders count too.
    """
    now = time.time()
    files = [f for folder in folders for f in (folder, *folder.rglob("*")) if f.is_file()]
    ahead = [file for file in files if file.stat().st_mtime > now + SKEW]
    for file in ahead:
        os.utime(file, (now, now))
    if ahead:
        print(
            f"{ahead[0]} and {len(ahead) - 1} more were from the future: the clock has gone back",
            file=sys.stderr,
        )
