"""A start for the chain: region materials by their evidence, with the light integrated out roughly.

Roughness and light explain each other: moving one while the other is held gets stuck at whatever the fit had. Here some
of the points do for all, the light is log-normal, smooth neither nor natural, and integrated by Laplace's method for
every roughness and metallic tried.
"""

from __future__ import annotations

import numpy as np
import torch

from ..transport import Rows
from .likelihood import Lobes, Photos, Theta
from .region_moves import METALLIC, log_prior
from .split_gibbs import Curvature

SPREAD = 1.2            # deviation of the start light's log radiance
ERROR = 0.1             # relative error assumed during the search
STEPS = 3               # Newton steps on log light, and on the colours, per proposal


def subset(photos: Photos, points: np.ndarray) -> Photos:
    """Some of the points only, without light off the object."""
    keep = np.isin(photos.rows.point, points)
    lobes = object.__new__(Lobes)
    lobes.levels, index = photos.lobes.levels, torch.from_numpy(np.flatnonzero(keep))
    lobes.direct = [F[:, index] for F in photos.lobes.direct]
    lobes.off = [[g[keep] for g in G] for G in photos.lobes.off]
    rows = Rows(photos.rows.observation[keep], np.searchsorted(np.sort(points), photos.rows.point[keep]))
    out = Photos(photos.transport, lobes, photos.observed[keep], photos.clipped[keep], photos.region[np.sort(points)], 1, rows)
    out.eta, out.weight = ERROR, np.where(out.clipped, 0.05, 1.0)             # saturated rows say little here
    return out


class Search:
    """Metropolis-Hastings over each region's roughness and metallic, log radiance ~ N(log_scale, SPREAD^2) per pixel."""

    def __init__(self, photos: Photos, log_scale: float, points: int, rng: np.random.Generator):
        chosen = [rng.permutation(np.flatnonzero(photos.region == r)) for r in range(photos.region.max() + 1)]
        share = min(1.0, points / len(photos.region))
        chosen = np.concatenate([c[:max(8, round(share * len(c)))] for c in chosen])    # small regions have a say too
        self.photos, self.log_scale = subset(photos, chosen), log_scale

    def solve(self, theta: Theta, q: torch.Tensor) -> tuple[float, Theta, torch.Tensor]:
        """Log evidence with the light integrated out, mean colours that fit, log light (3, M); from a start q."""
        photos, theta = self.photos, theta.copy()
        for _ in range(STEPS):
            photos.set(theta)
            L = torch.exp(q)
            T, y = photos.whitened(L.T.numpy().astype(np.float64))
            slope = L * torch.einsum("cnm,cn->cm", T, y - torch.einsum("cnm,cm->cn", T, L)) - (q - self.log_scale) / SPREAD**2
            A = [Curvature(T[c] * L[c], SPREAD) for c in range(3)]
            step = torch.stack([a.solve(b) for a, b in zip(A, slope)])
            q = q + step * min(1.0, 1.5 / float(step.abs().max()))
            theta = self.colours(theta, q)
        photos.set(theta)
        value = photos.value(torch.exp(q).T.numpy().astype(np.float64)) - 0.5 * float((q - self.log_scale).square().sum()) / SPREAD**2
        return value - 0.5 * sum(a.log_determinant() for a in A) + float(log_prior(theta).sum()), theta, q

    def colours(self, theta: Theta, q: torch.Tensor) -> Theta:
        """Mean and spread of the points' best base colours in each region."""
        photos, out = self.photos, theta.copy()
        U, W = photos.predict(torch.exp(q).T.numpy().astype(np.float64))
        v = (theta.tau[photos.region, None] * theta.mu[photos.region]) ** 2
        precision, pull, _ = photos.sums(U, W, np.zeros_like(U))
        colour = np.clip((pull + theta.mu[photos.region] / v) / (precision + 1 / v), 1e-3, 1.2)
        for r in range(len(theta.m)):
            mine = colour[photos.region == r]
            out.mu[r] = np.clip(mine.mean(0), 0.01, 0.95)
            out.tau[r] = np.clip((mine.std(0) / out.mu[r]).mean(), 0.05, 1.5)
        return out

    def run(self, theta: Theta, tries: int, rng: np.random.Generator) -> tuple[Theta, torch.Tensor]:
        """Theta and log light (3, M) after `tries` proposals per region."""
        q = torch.full((3, self.photos.lobes.direct[0].shape[-1]), self.log_scale)
        for _ in range(3):
            now, theta, q = self.solve(theta, q)
        levels = len(self.photos.lobes.levels)
        for turn in range(tries):
            for r in rng.permutation(len(theta.m)):
                new = theta.copy()
                if turn % 2 == 0:                                             # anywhere, then nearby
                    new.level[r], new.m[r] = rng.integers(levels), METALLIC[rng.choice([0, 4, 8, 12])]
                else:
                    new.level[r] = np.clip(theta.level[r] + rng.integers(-1, 2), 0, levels - 1)
                then, new, new_q = self.solve(new, q)
                if np.log(rng.random()) < then - now:
                    theta, q, now = new, new_q, then
        return theta, q
