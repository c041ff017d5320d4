"""Procedural lights as the training data of generators, for which no measured map is needed."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from pipeline.base.errors import InputError
from pipeline.base.files import atomic_path
from pipeline.base.progress import progress
from pipeline.prior.training.augment import draw_view
from pipeline.prior.training.data import half, radiance, scale_free
from pipeline.prior.training.procedural import generate
from pipeline.prior.value_code import Code, to_log


@dataclass
class MadeLights:
    """codes (n, 3, height, 2 height) of views of the lights, and the code that they are in."""

    codes: torch.Tensor
    code: Code

    def turned(self, count: int, rng: np.random.Generator) -> torch.Tensor:
        """`count` random views, each turned by random columns and half of them mirrored."""
        chosen = []
        for k in rng.integers(len(self.codes), size=count):
            view = self.codes[k].roll(int(rng.integers(self.codes.shape[-1])), -1)
            chosen.append(view.flip(-1) if rng.random() < 0.5 else view)
        return torch.stack(chosen)


def make_lights(count: int, height: int, seed: int, cache: Path) -> np.ndarray:
    """`count` lights of pipeline.prior.training.procedural with 2 `height` rows, as `half` stores
    them; kept in `cache` (.npz). Raises InputError where that holds other ones.
    """
    wanted = np.array([count, 2 * height, seed])
    if not cache.exists():
        maps, _ = generate(count, 2 * height, seed)
        with atomic_path(cache) as temporary, open(temporary, "wb") as file:
            np.savez(file, maps=np.stack([half(scale_free(m)) for m in maps]), wanted=wanted)
    with np.load(cache) as file:
        if not np.array_equal(file.get("wanted"), wanted):
            raise InputError("holds other lights than are asked for", cache, "remove it")
        return file["maps"]


def views_of(stored: np.ndarray, height: int, each: int, seed: int) -> MadeLights:
    """`each` random views (augment.draw_view) of every light."""
    rng = np.random.default_rng(seed)
    logs = []
    for one in progress(stored, "views of lights"):
        env = radiance(one)
        logs += [to_log(scale_free(draw_view(env, height, rng))) for _ in range(each)]
    values = np.stack(logs)
    code = Code(float(values.mean()), float(values.std()))
    return MadeLights(torch.from_numpy((values - code.mean) / (2 * code.std)), code)
