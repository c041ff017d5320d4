"""What every stage's command line shares: configuration, folders in, folder out, threads, timing,
plain errors.
"""

from __future__ import annotations

import argparse
import errno
import os
import re
import resource
import time
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

import yaml

from pipeline.base import runtime
from pipeline.base.config import NOT_YAML, Scene, load_scene
from pipeline.base.errors import InputError, run_stage


def overrides(settings: list[str]) -> dict:
    """['preset=draft', 'mesh.grid=96'] -> nested mapping; values are YAML scalars."""
    out: dict = {}
    for item in settings:
        key, found, value = item.partition("=")
        if not found:
            raise InputError(
                f"expected key=value, got '{item}'", "--set", "for example --set mesh.grid=128"
            )
        *sections, last = key.split(".")
        place = out
        for section in sections:
            place = place.setdefault(section, {})
            if not isinstance(place, dict):
                raise InputError(
                    f"'{item}': {section} has a value already", "--set", "give it one value only"
                )
        try:
            place[last] = yaml.safe_load(value)
        except NOT_YAML as error:
            raise InputError(
                f"'{item}' is not valid YAML ({error})", "--set", "quote or correct the value"
            ) from error
    return out


def _threads(text: str) -> int:
    """A number of threads for argparse. Raises InputError below 1."""
    if not text.isdecimal() or int(text) < 1:
        raise InputError(f"'{text}' is no number of threads", "--threads", "give 1 or more")
    return int(text)


# What `load_problem` (posterior/load.py) reads: the folders of fit, sample and refine.
PROBLEM_FOLDERS = {
    "observe": "folder of the observe stage",
    "poses": "folder of the poses stage",
    "atlas": "folder of the atlas stage",
    "mesh": "folder of the mesh stage (its surface's facts, its final masks)",
}


# The chosen settings, which those stages and the report take in place of the configured ones.
CHOSEN_FOLDER = {"choose": "folder of the choose stage (the settings that it has chosen)"}


class Stage:
    """Parsed command line of a stage: `.scene` (validated), `.out`, `.args` and one Path per input
    folder.
    """

    def __init__(self, parser: argparse.ArgumentParser):
        self.args = parser.parse_args()
        self.scene: Scene = load_scene(self.args.config, overrides(self.args.set))
        self.out: Path = self.args.out
        self.start = time.monotonic()

    @property
    def problem_folders(self) -> tuple[Path, Path, Path, Path]:
        """Those of PROBLEM_FOLDERS, in the order that `load_problem` takes them."""
        return self.args.observe, self.args.poses, self.args.atlas, self.args.mesh

    def costs(self) -> dict:
        """Wall seconds and peak resident memory of this process so far, and the time: for the
        stage's metrics.

        By the time no two runs leave the same metrics, so that Snakemake, which compares small
        files by content, sees in them that the stage has run.
        """
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
        return {
            "seconds": round(time.monotonic() - self.start, 2),
            "peak_gib": round(peak, 3),
            "finished": datetime.now(UTC).isoformat(),
        }


# what a disk may refuse, in words, and what helps
DISK = {
    errno.ENOSPC: ("the disk is full", "free some space and run again; finished stages are kept"),
    errno.EDQUOT: ("the disk's quota is used up", "free some space and run again"),
    errno.EROFS: ("the disk can only be read", "choose a folder you may write to"),
    errno.EIO: ("the disk does not answer", "copy the photos to another disk"),
}


# numpy's words where a disk takes less than it is given; its error has no number
CUT_SHORT = re.compile(r"^\d+ requested and \d+ written$")


def of_the_disk(error: OSError | RuntimeError, out: Path) -> Exception:
    """An InputError for what the disk refuses; any other error as it is. OpenEXR has the system's
    words for it in the text of a RuntimeError.
    """
    place = None
    if CUT_SHORT.match(str(error)):
        number: int | None = errno.ENOSPC
    elif isinstance(error, OSError):
        number, place = error.errno, error.filename
    else:
        number = next((n for n in DISK if os.strerror(n) in str(error)), None)
    if number not in DISK:
        return error

    what, cure = DISK[number]
    return InputError(what, place or out, cure)


def stage(
    doc: str | None,
    inputs: dict[str, str],
    work: Callable[[Stage], None],
    extra: Callable[[argparse.ArgumentParser], object] | None = None,
) -> None:
    """Run `work(Stage)` as a command. `inputs` maps option names to help texts; `extra(parser)` may
    add options.
    """

    def main() -> None:
        parser = argparse.ArgumentParser(
            description=doc, formatter_class=argparse.RawDescriptionHelpFormatter
        )
        parser.add_argument("--config", required=True, type=Path, help="configs/<scene>.yaml")
        parser.add_argument(
            "--set",
            action="append",
            default=[],
            metavar="KEY=VALUE",
            help="override one setting, e.g. preset=draft or mesh.grid=128",
        )
        for name, text in inputs.items():
            parser.add_argument(f"--{name}", required=True, type=Path, help=text)
        parser.add_argument(
            "--out",
            required=True,
            type=Path,
            help="folder (or file) to write; replaced when complete",
        )
        parser.add_argument("--threads", type=_threads, default=2)
        if extra:
            extra(parser)
        parsed = Stage(parser)
        runtime.set_threads(parsed.args.threads)
        try:
            work(parsed)
        except (OSError, RuntimeError) as error:
            raise of_the_disk(error, parsed.out) from error

    run_stage(main)
