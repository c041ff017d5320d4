"""What a stage has made, with sizes, so that a later run sees what lost its end since: a power cut,
a full disk and a copy that was broken off leave files that are too short.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterable
from pathlib import Path

NAME = ".files.json"
TOUCHED = 10 * 10**9  # ns after a stage's end in which Snakemake may set the times of its files


def sync(path: Path) -> None:
    """Wait until a file, or a folder's list of names, is on the disk itself."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def sync_all(folder: Path) -> None:
    """As `sync`, for all that is in a folder."""
    for path in sorted(folder.rglob("*"), reverse=True):  # what is in a folder before the folder
        if not path.is_symlink():
            sync(path)
    sync(folder)


def write_manifest(manifest: Path, files: Iterable[Path]) -> None:
    """Note size and time of `files` in the file `manifest`, by paths from its folder."""
    top = manifest.parent
    noted = {}
    for file in sorted(files):
        about = file.stat()
        noted[os.path.relpath(file, top)] = [about.st_size, about.st_mtime_ns]
    manifest.write_text(json.dumps(noted, ensure_ascii=False), encoding="utf-8")


def damaged(manifest: Path) -> list[str]:
    """The files, by paths from the folder of `manifest`, that are not what was noted there; itself
    where it cannot be read. Nothing where there is no manifest.

    In its own folder every file must be there with its size. Files elsewhere are exports, which a
    user may delete and edit: they count as damaged where they are empty, or are shorter but still
    have the time at which the stage has left them (to TOUCHED), which no editor does.
    """
    if not manifest.exists():
        return []
    entries = _entries(manifest)
    if entries is None:
        return [manifest.name]
    return [name for name, size, time in entries if _is_damaged(manifest.parent, name, size, time)]


def _entries(manifest: Path) -> list[tuple[str, int, int]] | None:
    """Path, size and time of every file in a manifest; None where it cannot be read."""
    try:
        noted = json.loads(manifest.read_text(encoding="utf-8"))
        return [(name, int(size), int(time)) for name, (size, time) in noted.items()]
    except (ValueError, TypeError, AttributeError):
        return None


def note_anew(manifest: Path) -> None:
    """Note what is left of the files in `manifest` as they are now: nothing counts as damaged any
    more, and what is left is still known to be of a stage. One that cannot be read is deleted.
    """
    entries = _entries(manifest)
    if entries is None:
        manifest.unlink()
        return
    files = [manifest.parent / name for name, _, _ in entries]
    write_manifest(manifest, [file for file in files if file.exists()])


def is_remainder(folder: Path) -> bool:
    """Whether all files in a folder are noted in its manifest: what is left of a stage's result,
    of which Snakemake deletes the files that it knows of when it sees the stage die after its end.
    """
    if not (folder / NAME).exists():
        return False
    known = {NAME, *(name for name, _, _ in _entries(folder / NAME) or [])}
    files = (path for path in folder.rglob("*") if not path.is_dir() or path.is_symlink())
    return all(path.relative_to(folder).as_posix() in known for path in files)


def _is_damaged(top: Path, name: str, size: int, time: int) -> bool:
    elsewhere = name.startswith("..")
    file = top / name
    if not file.exists():
        return not elsewhere

    about = file.stat()
    if not elsewhere:
        return about.st_size != size
    as_left = abs(about.st_mtime_ns - time) <= TOUCHED
    return about.st_size < size and (as_left or about.st_size == 0)
