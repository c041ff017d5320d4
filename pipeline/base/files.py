"""Whole files or none: everything is written under a temporary name beside its target and renamed
when complete.
"""

from __future__ import annotations

import contextlib
import json
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.base import manifest
from pipeline.base.errors import InputError
from pipeline.base.locks import alone


def writable_parent(path: Path) -> None:
    """InputError where the folder of `path` cannot be made or written to."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(
            f"the folder cannot be made ({error.strerror})",
            path.parent,
            "choose a folder you may write to",
        ) from error
    if not os.access(path.parent, os.W_OK):
        raise InputError(
            "the folder cannot be written to",
            path.parent,
            "change its permissions (chmod u+w) or choose another folder",
        )


@contextlib.contextmanager
def atomic_path(path: str | Path) -> Iterator[Path]:
    """Yield a temporary path with the same suffix; on success it replaces `path`, on failure it is
    removed.

    The temporary name is the same for every run, so that a killed run's leftover is overwritten,
    not collected.
    """
    path = Path(path)
    writable_parent(path)

    temporary = path.with_name(f".partial-{path.name}")
    try:
        yield temporary
        manifest.sync(temporary)
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def _replaceable(path: Path, mark: str) -> None:
    """InputError unless `path` may be replaced as a whole: it is not there, or an empty folder, or
    an earlier result, which holds the file `mark`, or what is left of one (`is_remainder`); and
    nobody works in it or below it.
    """
    whole = Path(os.path.realpath(path))
    here = Path(os.path.realpath(os.curdir))
    if here.is_relative_to(whole):
        raise InputError(
            "this folder holds the one that you are in, and a stage replaces its folder whole",
            path,
            "choose a folder of its own for --out",
        )
    if path.is_symlink() or (path.exists() and not path.is_dir()):
        raise InputError("this is no folder", path, "choose another name for --out")
    empty = not path.exists() or not any(path.iterdir())
    if not (empty or (path / mark).exists() or manifest.is_remainder(path)):
        raise InputError(
            f"the folder is not empty and holds no {mark}: it is no earlier result of this stage",
            path,
            "choose another folder for --out, or empty this one yourself",
        )


@contextlib.contextmanager
def stage_folder(path: str | Path, mark: str) -> Iterator[Path]:
    """As `atomic_path`, for a folder: the old content stays in place until the new is complete.

    mark: the file that every complete result of this kind holds. Raises InputError, before and
    after the work, for a folder with anything else in it: it would be deleted.
    """
    path = Path(path)
    _replaceable(path, mark)
    writable_parent(path)

    with alone(path), room_beside(path) as room:
        new = room / "new"
        new.mkdir()
        yield new
        manifest.write_manifest(new / manifest.NAME, [p for p in new.rglob("*") if p.is_file()])
        manifest.sync_all(new)
        _replaceable(path, mark)
        if path.exists():
            os.replace(path, room / "old")  # one step: a kill leaves no half of it
        os.replace(new, path)
        manifest.sync(path.parent)


@contextlib.contextmanager
def room_beside(path: Path) -> Iterator[Path]:
    """An empty folder beside `path`, removed in the end."""
    room = path.with_name(f".partial-{path.name}")
    shutil.rmtree(room, ignore_errors=True)  # a killed run's leftover
    room.mkdir()
    try:
        yield room
    finally:
        shutil.rmtree(room, ignore_errors=True)


def _plain(value: object) -> object:
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, Path):
        return str(value)
    raise TypeError(f"not JSON: {type(value)}")


def write_json(path: str | Path, data: object) -> None:
    """Write `data` (numpy values allowed) as UTF-8 JSON, atomically; NaN and infinity are
    refused.
    """
    with atomic_path(path) as temporary:
        text = json.dumps(data, indent=1, default=_plain, allow_nan=False, ensure_ascii=False)
        temporary.write_text(text + "\n", encoding="utf-8")


def read_json(path: str | Path) -> Any:
    """Read JSON; a missing or broken file is an InputError naming it."""
    path = Path(path)
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise InputError(
            "the file is missing", path, "run the stage that makes it first"
        ) from error
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"not valid JSON ({error})", path, "repair or delete the file") from error


def json_entry(path: str | Path, key: str) -> Any:
    """One entry of a stage's JSON. Raises InputError where the entry is missing because an earlier
    version, which did not write it, ran the stage.
    """
    found = read_json(path)
    if key not in found:
        raise InputError(
            f"no entry '{key}': an earlier version made this file",
            path,
            "delete its folder and run the stage again",
        )
    return found[key]


def report_metrics(path: str | Path, metrics: dict) -> None:
    """A stage's last act: its metrics to `path` and as one JSON line to standard output."""
    write_json(path, metrics)
    print(json.dumps(metrics, default=_plain, ensure_ascii=False))
