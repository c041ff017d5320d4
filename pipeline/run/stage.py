"""What every stage's command line shares: configuration, folders in, folder out, threads, timing,
plain errors.
"""

from __future__ import annotations

import argparse
import resource
import time
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

import yaml

from pipeline.base import runtime
from pipeline.base.config import Scene, load_scene
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
        place[last] = yaml.safe_load(value)
    return out


# What `load_problem` (posterior/load.py) reads: the folders of fit, sample and refine.
PROBLEM_FOLDERS = {
    "observe": "folder of the observe stage",
    "poses": "folder of the poses stage",
    "atlas": "folder of the atlas stage",
    "mesh": "folder of the mesh stage (its surface's facts, its final masks)",
}


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
        parser.add_argument("--threads", type=int, default=2)
        if extra:
            extra(parser)
        parsed = Stage(parser)
        runtime.set_threads(parsed.args.threads)
        work(parsed)

    run_stage(main)
