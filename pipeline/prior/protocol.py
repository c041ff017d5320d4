"""What a prior over natural light is to a sampler."""

from __future__ import annotations

from typing import Protocol

import numpy as np
import torch


class LightPrior(Protocol):
    """A prior over lat-long lights of (height, width = 2 height) pixels, in codes.

    Codes are (n, 3, height, width) with a standard deviation of 0.5 (prior/value_code.py).
    """

    height: int
    width: int

    @property
    def log_spread(self) -> float:
        """Change of log radiance per unit of code."""
        ...

    def denoise(self, x: torch.Tensor, sigma: float, label: str | None = None) -> torch.Tensor:
        """E[x_0 | x_0 + sigma n = x] for codes, differentiable."""
        ...

    def decode(self, x: torch.Tensor) -> torch.Tensor:
        """Codes as scale-free radiance of the same shape, differentiable."""
        ...

    def encode(self, radiance: np.ndarray) -> torch.Tensor:
        """Scale-free radiance (height, width, 3) as a code (1, 3, height, width)."""
        ...
