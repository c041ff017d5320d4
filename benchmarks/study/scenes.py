"""Which scenes a study is of: a suite made here, or folders that are given."""

from __future__ import annotations

from pathlib import Path

from benchmarks.suite.make import SUITES, make_suite
from pipeline.base.errors import InputError, nearest


def scenes_of(
    suite: str, out: Path, given: Path | None = None, only: list[str] | None = None
) -> list[Path]:
    """Absolute scene folders: those of `suite`, made under `out` where they are not there, or all
    in `given`, in alphabetical order. only: names of those that are wanted, none: all. Raises
    InputError for an unknown suite or scene, and for given scenes under a suite's name.
    """
    if given is None:
        return [folder.resolve() for folder in make_suite(suite, out, only)]
    if suite in SUITES:
        cure = "rows of given scenes need a name of their own: --suite NAME"
        raise InputError(f"'{suite}' is a suite that is made here", "--suite", cure)
    found = {file.parents[1].name: file.parents[1] for file in given.glob("*/truth/envmap.exr")}
    if not found:
        cure = "benchmarks.pairs and benchmarks.make_scene make some"
        raise InputError("there are no scenes with truth/envmap.exr", given, cure)
    for asked in only or []:
        if asked not in found:
            raise InputError(f"{given} has no scene '{asked}'", "--scenes", nearest(asked, found))
    return [found[name].resolve() for name in sorted(found) if only is None or name in only]
