"""A light of nine spherical harmonics a channel, under Adam."""

from __future__ import annotations

import numpy as np
import torch

from pipeline.posterior.material_optimizer import BETAS
from pipeline.render.envmap import mean_radiance, sh_basis, sh_coefficients

DARKEST = 1e-3  # of the mean radiance: harmonics may be negative, light may not


class HarmonicLight:
    """max(sum_j c_j Y_j, floor); the coefficients c (9, 3) move in units of the mean radiance."""

    def __init__(self, light: np.ndarray, learning_rate: float):
        self.level = float(mean_radiance(light).mean())
        self.basis = sh_basis(*light.shape[:2])
        begin = sh_coefficients(light) / self.level
        self.coefficients = torch.from_numpy(begin.astype(np.float32))
        self.adam = torch.optim.Adam([self.coefficients], learning_rate, betas=BETAS)

    def _sum(self) -> np.ndarray:
        return self.level * np.einsum("jhw,jc->hwc", self.basis, self.coefficients.numpy())

    def light(self) -> np.ndarray:
        """Radiance (h, 2h, 3)."""
        return np.maximum(self._sum(), DARKEST * self.level).astype(np.float32)

    def step(self, slope: np.ndarray, light: np.ndarray) -> None:
        """One step of Adam, for the loss's `slope` in the radiance at `light`."""
        felt = np.where(self._sum() > DARKEST * self.level, slope, 0)
        down = self.level * np.einsum("jhw,hwc->jc", self.basis, felt)
        self.coefficients.grad = torch.from_numpy(down.astype(np.float32))
        self.adam.step()

    def set_learning_rate(self, learning_rate: float) -> None:
        self.adam.param_groups[0]["lr"] = learning_rate
