"""A start for the chain: region materials by their evidence, with the light integrated out roughly.

Roughness and light explain each other: moving one while the other is held gets stuck at whatever the fit had. Here some of the points
do for all, the light has the Gaussian prior's leading modes only, and region after region draws its roughness and metallic from
all candidates, the light and the region's colour integrated out by Laplace's method for each:

    log p(y | k) ~ l(c, k) + b' H^-1 b / 2 - log det H / 2,   H = I + sum over regions J' J,   b = sum J' r - c

Letters: c (K,) coefficients of the modes, J (3 n, K) and r (3 n,) whitened rows of one region linearised at c (coded.ModeCode).
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass

import numpy as np
import torch

from ..prior.gaussian import GaussianPrior
from ..transport import Rows
from .coded import COMPONENTS, ModeCode, Modes
from .likelihood import Photos, Theta
from .pooling import pooled
from .region_moves import METALLIC, log_prior
from .split_gibbs import cholesky

ROWS = 16               # of the light: the modes are no finer
ERROR, THINNING = 0.1, 3.0      # relative error, and rows per independent one, assumed during the search
LIGHT_FIRST = 3         # steps of the light at the fit's materials
CANDIDATES = METALLIC[[0, 4, 8, 12]]


def subset(photos: Photos, points: np.ndarray) -> Photos:
    """Some of the points only, as one region, under lights of ROWS rows; `points` sorted."""
    keep, transport, lobes = np.isin(photos.rows.point, points), copy(photos.transport), copy(photos.lobes)
    index, transport.h = torch.from_numpy(np.flatnonzero(keep)), min(ROWS, transport.h)
    lobes.direct = [pooled(F[:, index], transport.h) for F in photos.lobes.direct]
    lobes.off = [[g[keep] for g in G] for G in photos.lobes.off]
    rows = Rows(photos.rows.observation[keep], np.searchsorted(points, photos.rows.point[keep]))
    out = Photos(transport, lobes, photos.observed[keep], photos.clipped[keep], np.zeros(len(points), int), 1, rows)
    out.eta, out.kappa = ERROR, THINNING
    out.share = photos.share[points]
    return out


@dataclass
class Piece:
    """One region at one candidate: its Theta (of one region), log-likelihood, J'J (K, K) and J'r (K,)."""
    theta: Theta
    value: float
    H: torch.Tensor
    b: torch.Tensor


class Search:
    """Draws of each region's roughness and metallic given the other regions'; light codes = mean + modes c with c ~ N(0, 1)."""

    def __init__(self, photos: Photos, gaussian: GaussianPrior, log_scale: float, points: int, rng: np.random.Generator):
        share, self.parts = min(1.0, points / len(photos.region)), []
        for r in range(photos.region.max() + 1):
            mine = rng.permutation(np.flatnonzero(photos.region == r))
            self.parts.append(subset(photos, np.sort(mine[:max(8, round(share * len(mine)))])))      # small regions have a say too
        self.gaussian = gaussian
        self.about(gaussian, log_scale, gaussian.flat_mean)

    def about(self, prior, log_scale: float, mean: torch.Tensor, sigma: float = np.inf) -> ModeCode:
        """From now on lights are codes of `prior` about `mean`, seen through noise sigma (coded.ModeCode)."""
        modes = Modes(self.gaussian, prior, COMPONENTS, self.parts[0].transport.h)
        self.coded = ModeCode(self.parts[0], prior, log_scale, modes, mean, sigma)
        return self.coded

    def noise(self, eta: float, kappa: float) -> None:
        for part in self.parts:
            part.eta, part.kappa = eta, kappa

    def light(self, c: torch.Tensor) -> np.ndarray:
        """What the operator acts on (M', 3), of coefficients (K,)."""
        return self.coded.light(self.coded.code(c[None]))

    def linear(self, c: torch.Tensor) -> tuple[np.ndarray, torch.Tensor]:
        """The light (M', 3) at c and its change per mode (3, K, M')."""
        return self.light(c), self.coded.modes.moved(self.coded.slopes(self.coded.code(c[None]))[1]) * self.coded.keep[:, None]

    def piece(self, r: int, theta: Theta, light: np.ndarray, moved: torch.Tensor) -> Piece:
        """Region r with materials theta, its colour fitted to this light."""
        part = self.parts[r]
        part.set(theta)
        theta = fitted_colour(part, light)
        part.set(theta)
        T, residual, _ = part.whitened(light)
        J = torch.einsum("cnm,ckm->cnk", T, moved).reshape(-1, moved.shape[1])
        return Piece(theta, part.value(light), J.T @ J, J.T @ residual.reshape(-1))

    def pieces(self, thetas: list[Theta], c: torch.Tensor) -> tuple[list[Piece], tuple]:
        """Every region at its Theta, linearised at c; and what `linear` says there."""
        at = self.linear(c)
        return [self.piece(r, theta, *at) for r, theta in enumerate(thetas)], at

    def draw_material(self, group: list[int], pieces: list[Piece], at: tuple, c: torch.Tensor, rng, near: bool = False) -> tuple[list[Piece], torch.Tensor]:
        """One roughness and metallic for all regions of `group`, or what they have, by evidence: all pieces, and the light's step
        that goes with them (K,). at = linear(c).
        """
        levels = range(len(self.parts[0].lobes.levels))
        choices = [(level, m) for level in levels for m in CANDIDATES]
        if near:
            have = pieces[group[0]].theta
            choices = [(level, have.m[0]) for level in levels if abs(level - have.level[0]) < 3] + [(have.level[0], m) for m in CANDIDATES]
        changed = lambda choice: [self.piece(r, p.theta.made_of(*choice), *at) if r in group else p for r, p in enumerate(pieces)]
        found = []
        for candidate in [pieces] + [changed(choice) for choice in choices]:
            step, gain = light_step(candidate, c)
            prior = log_prior(joined(candidate)) + shared(candidate, len(choices))
            found.append((gain + sum(p.value for p in candidate) + prior, candidate, step))
        values = np.array([v for v, _, _ in found])
        odds = np.exp(values - values.max())
        return found[rng.choice(len(found), p=odds / odds.sum())][1:]

    def turn(self, theta: Theta, c: torch.Tensor, rng) -> tuple[Theta, torch.Tensor]:
        """One sweep over the regions from what they have and coefficients c (1, K), near candidates only."""
        c = c[0]
        pieces, at = self.pieces([theta.of([r]) for r in range(len(self.parts))], c)
        for r in rng.permutation(len(self.parts)):
            pieces, step = self.draw_material([r], pieces, at, c, rng, near=True)
            c = damped(c, step)
            pieces, at = self.pieces([p.theta for p in pieces], c)
        return joined(pieces), c[None]

    def run(self, theta: Theta, sweeps: int, rng: np.random.Generator) -> tuple[Theta, torch.Tensor]:
        """Theta of all regions and the light's coefficients (1, K) after `sweeps` region by region; between them all regions at once."""
        c, count = torch.zeros(self.coded.size), len(self.parts)
        pieces, at = self.pieces([theta.of([r]) for r in range(count)], c)
        for group in [None] * LIGHT_FIRST + groups(count, sweeps, rng):       # None: the light alone, at the fit's materials
            pieces, step = self.draw_material(group, pieces, at, c, rng) if group else (pieces, light_step(pieces, c)[0])
            c = damped(c, step)
            pieces, at = self.pieces([p.theta for p in pieces], c)
        return joined(pieces), c[None]


def joined(pieces: list[Piece]) -> Theta:
    """The materials of all pieces."""
    return Theta.joined([p.theta for p in pieces])


def light_step(pieces: list[Piece], c: torch.Tensor) -> tuple[torch.Tensor, float]:
    """Newton step (K,) of the light's coefficients at c, and b' H^-1 b / 2 - log det H / 2."""
    factor = cholesky(torch.eye(len(c)) + sum(p.H for p in pieces))
    slope = sum(p.b for p in pieces) - c
    step = torch.cholesky_solve(slope[:, None], factor)[:, 0]
    return step, 0.5 * float(slope @ step) - float(factor.diagonal().log().sum())


def groups(count: int, sweeps: int, rng: np.random.Generator) -> list[list[int]]:
    """Which regions move together, in order: each alone, in a new order every sweep; all at once between sweeps."""
    out = []
    for k in range(sweeps):
        out += [list(range(count))] if k else []
        out += [[r] for r in rng.permutation(count)]
    return out


def shared(pieces: list[Piece], choices: int) -> float:
    """Log-probability that regions share materials as they do: a Chinese restaurant process (Aldous 1985), up to a constant."""
    have = [(p.theta.level[0], p.theta.m[0]) for p in pieces]
    return sum(np.log1p(choices * have[:r].count(material)) for r, material in enumerate(have))


def damped(c: torch.Tensor, step: torch.Tensor) -> torch.Tensor:
    """c moved by at most 3 deviations of any mode: log light is linear nearby only."""
    return c + step * min(1.0, 3.0 / max(float(step.abs().max()), 1e-9))


def fitted_colour(part: Photos, light: np.ndarray) -> Theta:
    """The region's Theta with mean and spread of the points' best base colours under this light."""
    out = part.theta.copy()
    U, W = part.predict(light)
    colour = np.clip(part.colours(*part.sums(U, W, out, part.counted(U, W, out))[:2], out)[0], 1e-3, 1.2)
    out.mu[0] = np.clip(colour.mean(0), 0.01, 0.95)
    out.tau[0] = np.clip((colour.std(0) / out.mu[0]).mean(), 0.05, 1.5)
    return out
