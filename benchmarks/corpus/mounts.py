"""A disk that is full, or cannot be written: mounted in a name space of the child's own, where the
machine allows that without being root.
"""

from __future__ import annotations

import ctypes
import os
from collections.abc import Callable
from pathlib import Path

NAME_SPACE = "/proc/self/ns/mnt"
NEW_MOUNTS = 0x00020000
NEW_USER = 0x10000000
READ_ONLY = 1
REMOUNT = 32
BIND = 4096


class NotPossible(Exception):
    """The machine does not allow mounts."""


def _call(name: str, *arguments: object) -> None:
    library = ctypes.CDLL(None, use_errno=True)
    if getattr(library, name)(*arguments):
        raise NotPossible(f"{name}: {os.strerror(ctypes.get_errno())}")


def _own_mounts() -> None:
    """Enter a name space in which this process may mount, and nobody else sees it."""
    before = os.readlink(NAME_SPACE)
    user, group = os.getuid(), os.getgid()
    _call("unshare", NEW_MOUNTS if user == 0 else NEW_USER | NEW_MOUNTS)
    if os.readlink(NAME_SPACE) == before:
        raise NotPossible("unshare has changed nothing")
    if user == 0:
        _call("mount", b"none", b"/", None, ctypes.c_ulong(0x4000 | (1 << 18)), None)  # private
        return
    Path("/proc/self/setgroups").write_text("deny")
    Path("/proc/self/uid_map").write_text(f"0 {user} 1")
    Path("/proc/self/gid_map").write_text(f"0 {group} 1")


def full(folder: str, kib: int) -> Callable[[], None]:
    """Put a disk of `kib` KiB at `folder`."""

    def enter() -> None:
        _own_mounts()
        os.makedirs(folder, exist_ok=True)
        options = f"size={kib}k".encode()
        _call("mount", b"none", os.fsencode(folder), b"tmpfs", ctypes.c_ulong(0), options)

    return enter


def read_only(folder: str) -> Callable[[], None]:
    """Make `folder` unwritable, for root too."""

    def enter() -> None:
        _own_mounts()
        os.makedirs(folder, exist_ok=True)
        path = os.fsencode(folder)
        _call("mount", path, path, None, ctypes.c_ulong(BIND), None)
        _call("mount", None, path, None, ctypes.c_ulong(BIND | REMOUNT | READ_ONLY), None)

    return enter
