"""Views of the maps that the diffusion priors learn from, as the training data of generators."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from pipeline.prior.training.data import Batches, Data
from pipeline.prior.value_code import Code


@dataclass
class Lights:
    """codes (n, 3, height, 2 height) of views of maps, and the code that they are in."""

    codes: torch.Tensor
    code: Code

    def turned(self, count: int, rng: np.random.Generator) -> torch.Tensor:
        """`count` random views, each turned by random columns and half of them mirrored."""
        chosen = []
        for k in rng.integers(len(self.codes), size=count):
            view = self.codes[k].roll(int(rng.integers(self.codes.shape[-1])), -1)
            chosen.append(view.flip(-1) if rng.random() < 0.5 else view)
        return torch.stack(chosen)

    def on(self, device: str) -> Lights:
        return Lights(self.codes.to(device), self.code)


def views_of(data: Data, count: int, real_share: float, seed: int) -> Lights:
    """`count` random views (augment.draw_view), of measured maps with chance `real_share`."""
    codes, _, _ = Batches(data, real_share, seed).draw(count)
    return Lights(torch.from_numpy(codes), Code(data.mean, data.std))
