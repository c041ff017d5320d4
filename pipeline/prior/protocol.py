"""What the samplers ask of a prior over natural light."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
import torch

from pipeline.prior.value_code import Code


class DenoisingPrior(Protocol):
    """A prior as reverse diffusion sees it."""

    def denoise(
        self, x: torch.Tensor, sigma: float, label: str | Sequence[str | None] | None = None
    ) -> torch.Tensor:
        """E[x_0 | x_0 + sigma n = x] for codes (n, 3, h, w), differentiable in x.

        `label`: one class for all codes or one for each, None where it is unknown. A prior without
        classes does not look at it.
        """


class Prior(DenoisingPrior, Protocol):
    """A prior over codes (n, 3, h, w) of lat-long lights; `h` is `height`, `w` is `width` = 2 h."""

    height: int
    width: int
    code: Code  # radiance <-> code, pixel by pixel
    shares: dict[str, float]  # of the classes among the maps trained on; {}: none, or not known

    @property
    def log_spread(self) -> float:
        """Change of log radiance per unit of code."""

    def decode(self, x: torch.Tensor) -> torch.Tensor:
        """Codes (n, 3, h, w) -> scale-free radiance of the same shape."""

    def encode(self, radiance: np.ndarray) -> torch.Tensor:
        """Radiance (h, w, 3) of any scale -> its code (1, 3, h, w)."""
