"""Pixels of the light that photos look into, as further rows of the linear model.

Each is a row of one entry: the radiance of a light pixel, with a normal error relative to what is
seen; where the photo is saturated a lower bound. Materials have no part in it. Neighbouring pixels
err together (the camera stands elsewhere than the object), and that is so for every pixel seen: all
of them count as if every THINNING-th was there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from pipeline.posterior.problem import SHADE
from pipeline.render.surroundings import Sightings

THINNING = 4.0


@dataclass(frozen=True)
class SeenLight:
    """s pixels of the operator's light: pixel (s,), its number; observed (s, 3); precision (s, 3),
    the root of the inverse variance; clipped (s,), whether `observed` is a lower bound.
    """

    pixel: np.ndarray
    observed: np.ndarray
    precision: np.ndarray
    clipped: np.ndarray

    @classmethod
    def none(cls) -> SeenLight:
        """No photo looks past the object."""
        return cls(np.zeros(0, int), np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0, bool))

    @classmethod
    def of(cls, sightings: Sightings | None, rows: int) -> SeenLight:
        """What is seen of a light of `rows` rows."""
        if sightings is None:
            return cls.none()
        table = sightings.pooled(rows)
        deviation = table.deviation.ravel()
        pixel = np.flatnonzero(np.isfinite(deviation))
        observed = table.radiance.reshape(-1, 3)[pixel].astype(np.float64)
        error = deviation[pixel, None] * (observed + SHADE) * np.sqrt(THINNING)
        return cls(pixel, observed, 1 / error, table.clipped.ravel()[pixel])

    def counted(self, light: np.ndarray) -> np.ndarray:
        """`precision` (s, 3), 0 where a lower bound is exceeded by a light (M, 3)."""
        exceeded = self.clipped[:, None] & (light[self.pixel] >= self.observed)
        return np.where(exceeded, 0, self.precision)

    def residual(self, light: np.ndarray) -> np.ndarray:
        """Whitened residuals (s, 3) of a light (M, 3)."""
        return self.counted(light) * (self.observed - light[self.pixel])

    def value(self, light: np.ndarray) -> float:
        """Log-likelihood of a light (M, 3) up to a constant."""
        return -0.5 * float((self.residual(light) ** 2).sum())

    def slope(self, light: np.ndarray) -> np.ndarray:
        """Derivative (M, 3) of the mean squared whitened residual in a light (M, 3)."""
        out = np.zeros(light.shape, np.float32)
        count = max(self.observed.size, 1)
        out[self.pixel] = -2 * self.counted(light) * self.residual(light) / count
        return out

    def rows(self, light: np.ndarray) -> torch.Tensor:
        """The whitened rows about a light (M, 3): (3, s, M)."""
        out = torch.zeros(3, len(self.pixel), len(light))
        weight = torch.from_numpy(self.counted(light).T.astype(np.float32))
        out[:, np.arange(len(self.pixel)), self.pixel] = weight
        return out
