"""A light that the generator of a small adversarial network makes of latent numbers (Goodfellow et
al. 2014; pixel norm of Karras et al. 2018).
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
import torch.nn.functional as F
from torch import nn

from pipeline.prior.network import Conv
from pipeline.prior.value_code import Code
from pipeline.prior.weight_facts import FIRST_ROWS, GENERATOR_ROWS

LATENTS = 64
CHANNELS = (128, 96, 64, 48)  # at 4, 8, 16 and 32 rows
SLOPE = 0.2  # of the leaky ReLU


def pixel_norm(x: torch.Tensor) -> torch.Tensor:
    """(n, c, h, w) over its root mean square of channels."""
    return x * (x.square().mean(1, keepdim=True) + 1e-8).rsqrt()


class AdversarialGenerator(nn.Module):
    """Codes (n, 3, h, 2h) of z (n, LATENTS) ~ N(0, 1): from 4x8 up, doubled by repetition, with
    convolutions that wrap around in longitude.
    """

    latents: tuple[int, ...] = (LATENTS,)

    def __init__(self, code: Code, channels: Sequence[int] = CHANNELS):
        super().__init__()
        self.code = code
        self.channels = tuple(channels)
        self.rows = GENERATOR_ROWS["adversarial"]({"channels": channels})
        self.enter = nn.Linear(LATENTS, channels[0] * FIRST_ROWS * 2 * FIRST_ROWS)
        self.first = Conv(channels[0], channels[0])
        self.up = nn.ModuleList([Conv(a, b) for a, b in zip(channels, channels[1:])])
        self.leave = nn.Conv2d(channels[-1], 3, 1)

    @classmethod
    def from_tensors(cls, tensors: dict, facts: dict) -> AdversarialGenerator:
        """From what pipeline.prior.training.train_generator wrote."""
        made = cls(Code(facts["mean"], facts["std"]), facts["channels"])
        made.load_state_dict(tensors)
        return made.eval().requires_grad_(False)

    @staticmethod
    def _active(x: torch.Tensor) -> torch.Tensor:
        return pixel_norm(F.leaky_relu(x, SLOPE))

    def forward(self, z: torch.Tensor) -> torch.Tensor:
        x = self.enter(z).reshape(len(z), self.channels[0], FIRST_ROWS, 2 * FIRST_ROWS)
        x = self._active(self.first(self._active(x)))
        for conv in self.up:
            x = self._active(conv(F.interpolate(x, scale_factor=2, mode="nearest")))
        return self.leave(x)

    def codes(self, z: torch.Tensor, height: int) -> torch.Tensor:
        """As `forward`, with `height` rows: every pixel is repeated. Raises ValueError where that
        is no multiple of the network's.
        """
        factor = height // self.rows
        if factor * self.rows != height:
            raise ValueError(f"{self.rows} rows do not divide {height}")
        return self(z).repeat_interleave(factor, 2).repeat_interleave(factor, 3)
