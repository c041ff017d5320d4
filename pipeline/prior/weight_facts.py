"""What weights say of themselves, read from their files' heads alone: without torch, so that the
Snakefile may ask at no cost.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from safetensors import SafetensorError, safe_open

from pipeline.base.errors import InputError
from pipeline.prior.locate import find_generator, find_prior, part_paths

LABELS = ("indoor", "outdoor", "studio", "night")  # index len(LABELS) stands for "no label"
FIRST_ROWS = 4  # of the adversarial network's first scale
CURE = (
    "give a file written by `python -m pipeline.prior.training.export` or "
    "pipeline.prior.training.fit_gaussian"
)


@dataclass(frozen=True)
class PriorFacts:
    """format: a key of `pipeline.prior.load.PRIORS`; height: rows of its maps; labels: classes that
    it may be conditioned on.
    """

    format: str
    height: int
    labels: tuple[str, ...]


def read_facts(path: Path) -> dict:
    """The facts that `save_parts` wrote beside the tensors of `path`, which may be in parts. Raises
    InputError where it did not write them.
    """
    facts = {}
    try:
        for part in part_paths(path):
            with safe_open(str(part), "np") as file:
                facts = json.loads((file.metadata() or {})["heliograph"])
    except (SafetensorError, KeyError, OSError, ValueError) as error:
        raise InputError(
            f"not a Heliograph light prior ({type(error).__name__}: {error})", path, CURE
        ) from error
    return facts


def prior_facts(name: str) -> PriorFacts:
    """Of the prior called `name` (see `find_prior`). Raises InputError."""
    path = find_prior(name)
    facts = read_facts(path)
    kind = facts.get("format", "diffusion")
    if "height" not in facts:
        raise InputError("not a Heliograph light prior (its rows are not said)", path, CURE)
    return PriorFacts(kind, int(facts["height"]), LABELS if kind == "diffusion" else ())


# format of a generator -> least rows of the lights that it makes, which divide the rows of all
GENERATOR_ROWS: dict[str, Callable[[dict], int]] = {
    "adversarial": lambda facts: FIRST_ROWS * 2 ** (len(facts["channels"]) - 1),
    "equivariant": lambda facts: 1,
}


def generator_rows(method: str) -> int:
    """Rows that divide those of every light of the generator that the sampler `method` inverts.
    Raises InputError.
    """
    path = find_generator(method)
    facts = read_facts(path)
    try:
        return GENERATOR_ROWS[facts["format"]](facts)
    except KeyError as error:
        raise InputError(
            f"not a generator of lights ({error!r})",
            path,
            "write one: python -m pipeline.prior.training.train_generator --help",
        ) from error
