"""Value code of the prior: radiance <-> code x with zero mean and standard deviation 0.5 (EDM's
sigma_data).

A map is first divided by its scale, the solid-angle power mean (mean of sqrt(L), squared): a sun or
a lamp hardly moves it, and a studio's black walls do not either. The scale is a variable of its
own. Then v = log(max(L, FLOOR)) and x = (v - mean) / (2 std). By Jensen the mean radiance is at
least the power mean, 1, so that the floor changes a map's energy by at most FLOOR = 0.3 %. Peaks up
to exp(TOP) = 2e6 times the scale are kept: the sun in one pixel of 64x128.
"""

from __future__ import annotations

import numpy as np
import torch

from pipeline.render.envmap import solid_angles

FLOOR = 3e-3
TOP = 14.5


def scale_of(env: np.ndarray) -> float:
    """Power mean with exponent 1/2 of the luminance-free mean of channels, over solid angle."""
    weights = solid_angles(*env.shape[:2]) / (4 * np.pi)
    return float((np.sqrt(env.mean(-1)) * weights).sum() ** 2)


def to_log(env: np.ndarray) -> np.ndarray:
    """Scale-free radiance (h, w, 3) -> v (3, h, w)."""
    return np.log(np.maximum(env, FLOOR)).transpose(2, 0, 1).astype(np.float32)


class Code:
    """The affine part; `mean` and `std` of v (scalars) come from the training data."""

    def __init__(self, mean: float, std: float):
        self.mean, self.std = float(mean), float(std)

    def encode(self, env: np.ndarray) -> torch.Tensor:
        """Scale-free radiance (h, w, 3) -> x (1, 3, h, w)."""
        return torch.from_numpy((to_log(env) - self.mean) / (2 * self.std))[None]

    def decode(self, x: torch.Tensor) -> torch.Tensor:
        """x (n, 3, h, w) -> scale-free radiance (n, 3, h, w), positive, differentiable."""
        return torch.exp((x * (2 * self.std) + self.mean).clamp(np.log(FLOOR) - 2, TOP))
