"""Which scenes a study is of: a suite made here, or folders that are given."""

from __future__ import annotations

import argparse
from pathlib import Path

from benchmarks.suite.make import SUITES, make_suite, scenes_named
from pipeline.base.errors import InputError


def add_options(parser: argparse.ArgumentParser) -> None:
    """`suite` and `given`, which `scenes_of` takes."""
    parser.add_argument("--suite", default="XS")
    parser.add_argument("--given", type=Path, help="folder of scenes; --suite is then their name")


def said(args: argparse.Namespace) -> str:
    """These options as rows say them: with SCENES for the folder of this machine."""
    return f"--suite {args.suite}" + (" --given SCENES" if args.given else "")


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
    found = sorted(file.parents[1].name for file in given.glob("*/truth/envmap.exr"))
    if not found:
        cure = "benchmarks.pairs and benchmarks.make_scene make some"
        raise InputError("there are no scenes with truth/envmap.exr", given, cure)
    wanted = scenes_named(only, found, str(given), "--scenes")
    return [(given / name).resolve() for name in wanted]
