"""Where a prior's weights lie. Without torch, so that the Snakefile may ask at no cost."""

from __future__ import annotations

import re
from pathlib import Path

from pipeline.base.errors import InputError, nearest

WEIGHTS = Path(__file__).resolve().parents[2] / "weights"
GENERATORS = WEIGHTS / "generators"  # of lights, by the name of the sampler that inverts them
SUFFIX = ".safetensors"


def known_priors() -> list[str]:
    """Names of the priors under weights/."""
    return sorted({p.stem.split("-")[0] for p in WEIGHTS.glob(f"*{SUFFIX}")})


def part_paths(path: Path) -> list[Path]:
    """The files that `path` (NAME.safetensors) stands for: itself, or its parts
    NAME-1-of-2.safetensors and so on; empty when there are none.

    Raises InputError when some parts are missing.
    """
    if path.exists():
        return [path]

    numbered = re.compile(rf"{re.escape(path.stem)}-\d+-of-(\d+)")
    files = sorted(path.parent.glob(f"*{SUFFIX}"))
    found = [(file, match) for file in files if (match := numbered.fullmatch(file.stem))]
    if found and len(found) != int(found[0][1][1]):
        parts = found[0][1][1]
        raise InputError(
            f"only {len(found)} of {parts} parts are there", path, "fetch the missing parts"
        )
    return [file for file, _ in found]


def find_prior(name: str) -> Path:
    """NAME.safetensors of a name under weights/, or the path itself; the file may be split into
    parts (`part_paths`).

    Raises InputError when there is no such file, and for a path of another format: weights are read
    as safetensors only, because other formats may run code when they are opened.
    """
    if not name.endswith(SUFFIX) and ("/" in name or Path(name).is_file()):
        raise InputError(
            f"weights are read from {SUFFIX} files only",
            name,
            "give a file written by `python -m pipeline.prior.training.export`, or the name of a "
            "prior under weights/",
        )

    path = Path(name) if name.endswith(SUFFIX) else WEIGHTS / f"{name}{SUFFIX}"
    if not part_paths(path):
        raise InputError("there is no such prior", path, nearest(name, known_priors() or ["none"]))
    return path


def prior_files(name: str) -> list[Path]:
    """Every file that the prior called `name` is read from."""
    return part_paths(find_prior(name))


def generator_files(method: str) -> list[Path]:
    """The weights that the sampler called `method` reads besides the priors': none for most."""
    return part_paths(GENERATORS / f"{method}{SUFFIX}")


def find_generator(method: str) -> Path:
    """The weights of the generator that the sampler `method` inverts. Raises InputError."""
    if not generator_files(method):
        raise InputError(
            "the generator of this sampler has no weights",
            GENERATORS / f"{method}{SUFFIX}",
            "check out weights/ again, or train: "
            "python -m pipeline.prior.training.train_generator --help",
        )
    return GENERATORS / f"{method}{SUFFIX}"
