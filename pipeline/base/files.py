"""Whole files or none: everything is written under a temporary name beside its target and renamed
when complete.
"""

from __future__ import annotations

import contextlib
import json
import os
import shutil
from pathlib import Path

import numpy as np

from pipeline.base.errors import InputError


def _writable_parent(path: Path) -> None:
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
def atomic_path(path: str | Path):
    """Yield a temporary path with the same suffix; on success it replaces `path`, on failure it is
    removed.

    The temporary name is the same for every run, so that a killed run's leftover is overwritten,
    not collected.
    """
    path = Path(path)
    _writable_parent(path)

    temporary = path.with_name(f".partial-{path.name}")
    try:
        yield temporary
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


@contextlib.contextmanager
def stage_folder(path: str | Path):
    """As `atomic_path`, for a folder: the old content stays in place until the new is complete."""
    path = Path(path)
    _writable_parent(path)

    temporary = path.with_name(f".partial-{path.name}")
    shutil.rmtree(temporary, ignore_errors=True)
    temporary.mkdir()
    try:
        yield temporary
        if path.exists():
            shutil.rmtree(path)
        os.replace(temporary, path)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def _plain(value):
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, Path):
        return str(value)
    raise TypeError(f"not JSON: {type(value)}")


def write_json(path: str | Path, data) -> None:
    """Write `data` (numpy values allowed) as UTF-8 JSON, atomically; NaN and infinity are
    refused.
    """
    with atomic_path(path) as temporary:
        text = json.dumps(data, indent=1, default=_plain, allow_nan=False, ensure_ascii=False)
        temporary.write_text(text + "\n", encoding="utf-8")


def read_json(path: str | Path):
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


def json_entry(path: str | Path, key: str):
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
