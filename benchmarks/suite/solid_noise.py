"""Gradient noise in space (Perlin 2002, Improving Noise), for solid textures and displacement."""

from __future__ import annotations

import numpy as np

TABLE = 256  # entries of the permutation table, a power of two


class SolidNoise:
    """Smooth random function of points in space, of zero mean; one of its own per seed."""

    def __init__(self, seed: int):
        rng = np.random.default_rng(seed)
        self.permutation = rng.permutation(TABLE)
        gradient = rng.normal(size=(TABLE, 3))
        self.gradient = gradient / np.linalg.norm(gradient, axis=1, keepdims=True)

    def _corner(self, cell: np.ndarray) -> np.ndarray:
        """Gradients (n, 3) at lattice points (n, 3)."""
        index = np.zeros(len(cell), int)
        for axis in range(3):
            index = self.permutation[(index + cell[:, axis]) % TABLE]
        return self.gradient[index]

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """Values (n,), about -0.7 to 0.7, at points (n, 3); one lattice cell per unit of length."""
        cell = np.floor(points).astype(int)
        inside = points - cell
        fade = inside**3 * (inside * (6 * inside - 15) + 10)
        out = np.zeros(len(points))
        for corner in np.ndindex(2, 2, 2):
            offset = np.array(corner)
            weight = np.where(offset == 1, fade, 1 - fade).prod(1)
            out += weight * (self._corner(cell + offset) * (inside - offset)).sum(1)
        return out

    def fractal(self, points: np.ndarray, octaves: int = 4) -> np.ndarray:
        """Sum of octaves, each twice as fine and half as strong as the one before, (n,)."""
        return sum(self(points * 2.0**k + 17.3 * k) * 0.5**k for k in range(octaves))
