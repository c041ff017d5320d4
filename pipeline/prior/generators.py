"""Priors over light that are generators, all of the form `LightGenerator`: a light is what a
network makes of latent numbers. They are earlier work's; posterior/illumination inverts them.

GENERATORS: format name in the weights' metadata -> loader(tensors, facts).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import torch

from pipeline.base.errors import InputError
from pipeline.prior.adversarial import AdversarialGenerator
from pipeline.prior.equivariant import EquivariantField
from pipeline.prior.locate import find_generator
from pipeline.prior.value_code import Code
from pipeline.prior.weight_files import load_parts


class LightGenerator(Protocol):
    """latents: shape of a light's latent numbers, each ~ N(0, 1); code: radiance <-> code; rows:
    divide the rows of every light that it makes.
    """

    latents: tuple[int, ...]
    code: Code
    rows: int

    def codes(self, z: torch.Tensor, height: int) -> torch.Tensor:
        """Codes (n, 3, height, 2 height) of latents (n, *latents), differentiable in them."""


GENERATORS: dict[str, Callable[[dict, dict], LightGenerator]] = {
    "adversarial": AdversarialGenerator.from_tensors,
    "equivariant": EquivariantField.from_tensors,
}


def load_generator(name: str) -> LightGenerator:
    """The generator whose weights are weights/generators/`name`.safetensors. Raises InputError
    where they are missing or not a generator's.
    """
    path = find_generator(name)
    tensors, facts = load_parts(path)
    try:
        return GENERATORS[facts["format"]](tensors, facts)
    except (KeyError, RuntimeError, TypeError) as error:
        raise InputError(
            f"not a generator of lights ({type(error).__name__}: {error})",
            path,
            "write one: python -m pipeline.prior.training.train_generator --help",
        ) from error
