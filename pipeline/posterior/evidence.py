"""A start for the chain: region materials by their evidence, with the light integrated out roughly.

Roughness and light explain each other: moving one while the other is held gets stuck at whatever the fit had. Here some
of the points do for all, the light has the Gaussian prior's leading components only, and is integrated by Laplace's
method for every roughness and metallic tried.
"""

from __future__ import annotations

from copy import copy

import numpy as np
import torch

from ..prior.gaussian import GaussianPrior
from ..transport import Rows
from .likelihood import Photos, Theta
from .region_moves import METALLIC, log_prior
from .split_gibbs import Curvature

COMPONENTS = 320        # of the Gaussian prior, per channel: 95 % of its variance
ERROR = 0.1             # relative error assumed during the search
STEPS = 2               # Newton steps on log light, and on the colours, per proposal


def subset(photos: Photos, points: np.ndarray) -> Photos:
    """Some of the points only, without light off the object."""
    keep = np.isin(photos.rows.point, points)
    lobes, index = copy(photos.lobes), torch.from_numpy(np.flatnonzero(keep))
    lobes.direct = [F[:, index] for F in photos.lobes.direct]
    lobes.off = [[g[keep] for g in G] for G in photos.lobes.off]
    rows = Rows(photos.rows.observation[keep], np.searchsorted(np.sort(points), photos.rows.point[keep]))
    out = Photos(photos.transport, lobes, photos.observed[keep], photos.clipped[keep], photos.region[np.sort(points)], 1, rows)
    out.eta, out.weight = ERROR, np.where(out.clipped, 0.05, 1.0)             # saturated rows say little here
    return out


class Search:
    """Metropolis-Hastings over each region's roughness and metallic; light codes = mean + B c with c ~ N(0, 1)."""

    def __init__(self, photos: Photos, gaussian: GaussianPrior, log_scale: float, points: int, rng: np.random.Generator):
        chosen = [rng.permutation(np.flatnonzero(photos.region == r)) for r in range(photos.region.max() + 1)]
        share = min(1.0, points / len(photos.region))
        chosen = np.concatenate([c[:max(8, round(share * len(c)))] for c in chosen])    # small regions have a say too
        self.photos, self.log_scale, self.prior = subset(photos, chosen), log_scale, gaussian
        self.B = gaussian.basis(COMPONENTS)
        self.mean = gaussian.flat_mean

    def code(self, c: torch.Tensor) -> torch.Tensor:
        """Code (3, M) of coefficients (3, k)."""
        return self.mean + c @ self.B.T

    def radiance(self, c: torch.Tensor) -> torch.Tensor:
        """(3, M)"""
        return float(np.exp(self.log_scale)) * self.prior.decode(self.code(c))

    def solve(self, theta: Theta, c: torch.Tensor) -> tuple[float, Theta, torch.Tensor]:
        """Log evidence with the light integrated out, mean colours that fit, coefficients (3, k); from a start c."""
        photos, theta = self.photos, theta.copy()
        for _ in range(STEPS):
            photos.set(theta)
            L = self.radiance(c)
            T, y, _ = photos.whitened(L.T.numpy().astype(np.float64))
            J = torch.stack([(t * (self.prior.log_spread * l)) @ self.B for t, l in zip(T, L)])
            residual = y - torch.einsum("cnm,cm->cn", T, L)
            A = [Curvature(j, 1.0) for j in J]
            step = torch.stack([a.solve(j.T @ r - x) for a, j, r, x in zip(A, J, residual, c)])
            c = c + step * min(1.0, 3.0 / float(step.abs().max()))
            theta = self.colours(theta, c)
        photos.set(theta)
        value = photos.value(self.radiance(c).T.numpy().astype(np.float64)) - 0.5 * float(c.square().sum())
        return value - 0.5 * sum(a.log_determinant() for a in A) + float(log_prior(theta).sum()), theta, c

    def colours(self, theta: Theta, c: torch.Tensor) -> Theta:
        """Mean and spread of the points' best base colours in each region."""
        photos, out = self.photos, theta.copy()
        U, W = photos.predict(self.radiance(c).T.numpy().astype(np.float64))
        v = (theta.tau[photos.region, None] * theta.mu[photos.region]) ** 2
        precision, pull, _ = photos.sums(U, W, np.zeros_like(U))
        colour = np.clip((pull + theta.mu[photos.region] / v) / (precision + 1 / v), 1e-3, 1.2)
        for r in range(len(theta.m)):
            mine = colour[photos.region == r]
            out.mu[r] = np.clip(mine.mean(0), 0.01, 0.95)
            out.tau[r] = np.clip((mine.std(0) / out.mu[r]).mean(), 0.05, 1.5)
        return out

    def run(self, theta: Theta, tries: int, rng: np.random.Generator) -> tuple[Theta, torch.Tensor]:
        """Theta and the light's coefficients (3, k) after `tries` proposals per region."""
        c = torch.zeros(3, self.B.shape[1])
        for _ in range(3):
            now, theta, c = self.solve(theta, c)
        levels = len(self.photos.lobes.levels)
        for turn in range(tries):
            for r in rng.permutation(len(theta.m)):
                new = theta.copy()
                if turn % 3 == 0:                                             # anywhere, then nearby
                    new.level[r], new.m[r] = rng.integers(levels), METALLIC[rng.choice([0, 4, 8, 12])]
                else:
                    new.level[r] = np.clip(theta.level[r] + rng.choice([-2, -1, 1, 2]), 0, levels - 1)
                then, new, new_c = self.solve(new, c)
                if np.log(rng.random()) < then - now:
                    theta, c, now = new, new_c, then
        return theta, c
