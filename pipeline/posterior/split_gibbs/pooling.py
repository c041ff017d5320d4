"""Light seen through a coarser grid than its own: what the operator T cannot tell apart need not be
solved for.

T acts on the solid-angle mean of blocks of light pixels, L' = P L. A code z moves L by diag(g), so
T moves by J' Q with Q = P diag(g); blocks do not overlap, hence Q Q^T = D is diagonal, and E =
D^-1/2 Q has orthonormal rows. In the space of E's rows the photos bind the code, beside it they say
nothing: all linear algebra happens in the small space.
"""

from __future__ import annotations

import numpy as np
import torch
from torch.nn.functional import avg_pool2d

from pipeline.render.envmap import solid_angles


def pooled(T: torch.Tensor, rows: int) -> torch.Tensor:
    """Operators (..., M) on a light as operators on one of `rows` rows, the same all over each of
    its pixels.
    """
    h = round((T.shape[-1] / 2) ** 0.5)
    return avg_pool2d(T.reshape(1, -1, h, 2 * h), h // rows, divisor_override=1).reshape(
        *T.shape[:-1], -1
    )


class Pool:
    """Blocks of f x f pixels of a light with `fine` rows make one of `coarse` rows; fine = f
    coarse.
    """

    def __init__(self, fine: int, coarse: int):
        if fine % coarse:
            raise ValueError(f"{fine} rows do not pool to {coarse}")
        f = fine // coarse
        self.shape = (coarse, f, 2 * coarse, f)
        rows = solid_angles(fine, 2 * fine)[:, 0].reshape(coarse, f)
        of_pixel = rows / (rows.sum(1, keepdims=True) * f)
        self.weight = torch.from_numpy(of_pixel.astype(np.float32))[None, :, :, None, None]

    def down(self, v: torch.Tensor) -> torch.Tensor:
        """Block means (3, M') of pixels (3, M)."""
        return v if self.shape[1] == 1 else self.total(v.reshape(len(v), *self.shape) * self.weight)

    def total(self, x: torch.Tensor) -> torch.Tensor:
        """Sums (3, M') over blocks (3, h, f, w, f); pixel by pixel of a block, 3 to 9 times as fast
        as torch's sum over two axes.
        """
        f = self.shape[1]
        pixels = (x[:, :, i, :, j] for i in range(f) for j in range(f))
        return sum(pixels, torch.zeros(())).reshape(len(x), -1)

    def up(self, u: torch.Tensor) -> torch.Tensor:
        """Adjoint of `down`: (3, M') -> (3, M)."""
        h, f, w, _ = self.shape
        return (
            (u.reshape(len(u), h, 1, w, 1) * self.weight).expand(-1, h, f, w, f).reshape(len(u), -1)
        )

    def norm(self, g: torch.Tensor) -> torch.Tensor:
        """Norm (3, M') of the rows of P diag(g), g (3, M)."""
        return self.total((g.reshape(len(g), *self.shape) * self.weight) ** 2).sqrt()

    def spread(self, u: torch.Tensor) -> torch.Tensor:
        """Every pixel of a block gets the block's value: (3, M') -> (3, M)."""
        h, f, w, _ = self.shape
        return u.reshape(len(u), h, 1, w, 1).expand(-1, h, f, w, f).reshape(len(u), -1)


class Fold:
    """E for slopes g (3, M), with `extra` more unknowns at the end of z that pass unchanged: z (3,
    M + extra) <-> (3, M' + extra).
    """

    def __init__(self, pool: Pool, g: torch.Tensor, extra: int):
        self.pool, self.g, self.size, self.extra = pool, g, g.shape[1], extra
        self.root = pool.norm(g).clamp_min(1e-20)  # D^1/2

    def down(self, z: torch.Tensor) -> torch.Tensor:
        return torch.cat(
            [self.pool.down(z[:, : self.size] * self.g) / self.root, z[:, self.size :]], 1
        )

    def up(self, u: torch.Tensor) -> torch.Tensor:
        k = u.shape[1] - self.extra
        return torch.cat([self.pool.up(u[:, :k] / self.root) * self.g, u[:, k:]], 1)


class Whole:
    """No folding: the identity."""

    def down(self, z: torch.Tensor) -> torch.Tensor:
        return z

    def up(self, u: torch.Tensor) -> torch.Tensor:
        return u
