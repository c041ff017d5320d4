"""Locks that the operating system releases when a process ends, however it ends."""

from __future__ import annotations

import contextlib
import fcntl
import os
from collections.abc import Iterator
from pathlib import Path
from typing import TextIO

from pipeline.base.errors import InputError


def lock(path: Path, wait: bool = False) -> TextIO:
    """Hold the lock `path`, a file that is made for it, until what is returned is closed or the
    process ends. BlockingIOError where another process holds it, unless told to wait.
    """
    handle = open(path, "w")
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
    except OSError:
        handle.close()
        raise
    return handle


@contextlib.contextmanager
def alone(result: Path, wait: bool = False) -> Iterator[None]:
    """Make `result` while no other process does. InputError where another one is at it, unless told
    to wait: what comes of two would be a mixture. The lock is a file beside it, which is removed in
    the end.
    """
    file = result.with_name(f".partial-{result.name}.lock")
    try:
        held = lock(file, wait)
        while not _is_at(held, file):  # another process has removed it since it was opened
            held.close()
            held = lock(file, wait)
    except BlockingIOError as error:
        raise InputError(
            "another process is making this result", result, "wait for it, or stop it first"
        ) from error

    try:
        yield
    finally:
        file.unlink(missing_ok=True)
        held.close()


def _is_at(handle: TextIO, path: Path) -> bool:
    """Whether an open file is still the one at `path`."""
    try:
        return os.path.samestat(os.fstat(handle.fileno()), path.stat())
    except FileNotFoundError:
        return False
