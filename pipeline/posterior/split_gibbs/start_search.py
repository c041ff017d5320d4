"""A start for the chain: region materials by their evidence, with the light integrated out roughly.

Roughness and light explain each other: moving one while the other is held gets stuck at whatever
the fit had. Here some of the points do for all, the light has the Gaussian prior's leading modes
only, and region after region draws its roughness and metallic from all candidates, the light and
the region's colour integrated out by Laplace's method for each:

    log p(y | k) ~ l(c, k) + b' H^-1 b / 2 - log det H / 2,   H = I + sum over regions J' J,   b =
    sum J' r - c

Letters: c (K,) coefficients of the modes, J (3 n, K) and r (3 n,) whitened rows of one region
linearised at c (coded.ModeCode).
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass

import numpy as np
import torch

from pipeline.posterior.split_gibbs.light_codes import ModeCode, Modes
from pipeline.posterior.split_gibbs.light_draws import cholesky
from pipeline.posterior.split_gibbs.likelihood import BETWEEN, METALLIC, Lobes, Photos, Theta, mix
from pipeline.posterior.split_gibbs.material_moves import categorical, log_prior
from pipeline.posterior.split_gibbs.pooling import pooled
from pipeline.prior.gaussian import GaussianPrior
from pipeline.render.rows import Rows
from pipeline.render.transport import Transport

ROWS = 16  # of the light: the modes are no finer
ERROR, THINNING = (
    0.1,
    3.0,
)  # relative error, and rows per independent one, assumed during the search
LIGHT_FIRST = 3  # steps of the light before materials are drawn
SEARCH_COMPONENTS = 200  # leading modes of the Gaussian prior
FEW = 0.05  # weight of saturated rows where they hardly count
UNIFORM = [
    (level * BETWEEN, m) for level in (0, 2, 5) for m in (0.0, 1.0)
]  # roughness level and metallic of whole objects
CANDIDATES = METALLIC[[0, 4, 8, 12]]


def coarse(photos: Photos) -> tuple[Transport, Lobes]:
    """Operator and lobes for lights of ROWS rows."""
    transport, lobes = copy(photos.transport), copy(photos.lobes)
    transport.h = min(ROWS, transport.h)
    lobes.direct = [pooled(F, transport.h) for F in photos.lobes.direct]
    return transport, lobes


def subset(photos: Photos, transport: Transport, lobes: Lobes, points: np.ndarray) -> Photos:
    """Some of the points only, as one region, seen by `coarse` lobes; `points` sorted."""
    keep, lobes = np.isin(photos.rows.point, points), copy(lobes)
    lobes.direct, lobes.off = (
        [F[:, torch.from_numpy(keep)] for F in lobes.direct],
        [],
    )  # the search leaves light between parts out
    rows = Rows(photos.rows.observation[keep], np.searchsorted(points, photos.rows.point[keep]))
    out = Photos(
        transport,
        lobes,
        photos.observed[keep],
        photos.clipped[keep],
        np.zeros(len(points), int),
        1,
        rows,
    )
    out.eta, out.kappa = ERROR, THINNING
    out.share, out.ceiling = photos.share[points], photos.ceiling[points]
    return out


@dataclass
class Piece:
    """One region at one candidate: its Theta (of one region), log-likelihood, J'J (K, K) and J'r
    (K,).
    """

    theta: Theta
    value: float
    H: torch.Tensor
    b: torch.Tensor


class Linear:
    """What the lobes of every region make of the light (M', 3) of coefficients c (K,) and of its
    changes per mode (3, K, M'): small matrices, of which those of any metallic are mixed.
    """

    def __init__(
        self, parts: list[Photos], c: torch.Tensor, light: np.ndarray, moved: torch.Tensor
    ):
        self.parts, self.c, self.light, self.moved, self.known = (
            parts,
            c,
            torch.from_numpy(light.astype(np.float32)),
            moved,
            {},
        )

    def lobes(self, r: int, level: int) -> tuple[np.ndarray, torch.Tensor]:
        """Region r's four lobes at a roughness level: under the light (4, n, 3), and under its
        modes (3, 4, n, K).
        """
        if (r, level) not in self.known:
            F = self.parts[r].lobes.at(level)
            self.known[r, level] = (
                (F @ self.light).numpy(),
                torch.stack([F @ change.T for change in self.moved]),
            )
        return self.known[r, level]


class Search:
    """Draws of each region's roughness and metallic given the other regions'; light codes = mean +
    modes c with c ~ N(0, 1).
    """

    def __init__(
        self,
        photos: Photos,
        gaussian: GaussianPrior,
        log_scale: float,
        points: int,
        rng: np.random.Generator,
    ):
        share, self.parts, small = min(1.0, points / len(photos.region)), [], coarse(photos)
        for r in range(photos.region.max() + 1):
            mine = rng.permutation(np.flatnonzero(photos.region == r))
            self.parts.append(
                subset(photos, *small, np.sort(mine[: max(8, round(share * len(mine)))]))
            )  # small regions have a say too
        modes = Modes(gaussian, gaussian, SEARCH_COMPONENTS, self.parts[0].transport.h)
        self.coded = ModeCode(self.parts[0], gaussian, log_scale, modes, gaussian.flat_mean)

    def linear(self, c: torch.Tensor) -> Linear:
        """The light at coefficients c (K,), as the regions see it."""
        code = self.coded.code(c[None])
        return Linear(
            self.parts,
            c,
            self.coded.light(code),
            self.coded.modes.moved(self.coded.slopes(code)[1]),
        )

    def stepped(self, theta: Theta, at: Linear, step: torch.Tensor) -> tuple[list[Piece], Linear]:
        """The light moved by a step (K,): pieces of theta (of all regions) there."""
        there = self.linear(damped(at.c, step))
        return self.pieces(theta, there), there

    def piece(self, r: int, theta: Theta, at: Linear) -> Piece:
        """Region r with materials theta, its colour fitted to this light."""
        part, level, m = self.parts[r], int(theta.level[0]), float(theta.m[0])
        light, modes = at.lobes(r, level)
        U, W = mix(light, m)
        part.theta = theta = fitted_colour(part, theta, U, W)
        rest, H, b = part.rest(U, W, theta), 0.0, 0.0
        for c, whiten in enumerate(part.whiteners(U, W)):
            u, w = mix(modes[c], m)
            J = whiten(float(theta.mu[0, c]) * u + w)
            H, b = (
                H + J.T @ J,
                b + J.T @ whiten(torch.from_numpy(rest[:, c : c + 1].astype(np.float32)))[:, 0],
            )
        return Piece(theta, float(part.point_values(U, W, theta).sum()), H, b)

    def pieces(self, theta: Theta, at: Linear) -> list[Piece]:
        """Every region at its part of theta."""
        return [self.piece(r, theta.of([r]), at) for r in range(len(self.parts))]

    def draw_material(
        self, group: list[int], pieces: list[Piece], at: Linear, rng
    ) -> tuple[Theta, torch.Tensor]:
        """One roughness and metallic for all regions of `group`, or what they have, by evidence:
        Theta of all regions, and the light's step that goes with it (K,).
        """
        lobes = self.parts[0].lobes
        choices = [
            (level, m)
            for level in range(0, len(lobes.levels), BETWEEN)
            for m in CANDIDATES
            if m <= lobes.most_metallic[level]
        ]
        changed = lambda choice: [
            self.piece(r, p.theta.made_of(*choice), at) if r in group else p
            for r, p in enumerate(pieces)
        ]
        found = []
        for candidate in [pieces] + [changed(choice) for choice in choices]:
            step, gain = light_step(candidate, at.c)
            prior = log_prior(joined(candidate)) + shared(candidate, len(choices))
            found.append((gain + sum(p.value for p in candidate) + prior, candidate, step))
        _, chosen, step = found[categorical(np.array([[v for v, _, _ in found]]), rng)[0]]
        return joined(chosen), step

    def settled(self, theta: Theta, at: Linear) -> tuple[list[Piece], Linear]:
        """Pieces of theta (of all regions) after a few steps of the light alone."""
        pieces = self.pieces(theta, at)
        for _ in range(LIGHT_FIRST):
            pieces, at = self.stepped(joined(pieces), at, light_step(pieces, at.c)[0])
        return pieces, at

    def sweep(
        self, order: list[list[int]], theta: Theta, c: torch.Tensor, rng
    ) -> tuple[Theta, torch.Tensor]:
        """Theta and coefficients (K,) after a draw for every group of `order`."""
        pieces, at = self.settled(theta, self.linear(c))
        for group in order:
            theta, step = self.draw_material(group, pieces, at, rng)
            pieces, at = self.stepped(theta, at, step)
        return joined(pieces), at.c

    def count_saturated(self, weight: float) -> None:
        """How much saturated rows count from now on."""
        for part in self.parts:
            part.weight = np.where(part.clipped, weight, 1.0)

    def alone(self, theta: Theta, flat: Linear) -> tuple[float, Theta, torch.Tensor]:
        """Log-evidence of materials by Laplace's method, where light and colours settle from the
        flat light; Theta and coefficients (K,) there.
        """
        at = flat
        for weight in (FEW, 1.0):
            self.count_saturated(weight)
            pieces, at = self.settled(theta, at)
            theta = joined(pieces)
        return (
            light_step(pieces, at.c)[1] + sum(p.value for p in pieces) + log_prior(theta),
            theta,
            at.c,
        )

    def run(
        self, theta: Theta, sweeps: int, rng: np.random.Generator
    ) -> list[tuple[Theta, torch.Tensor]]:
        """Two starts, Theta of all regions and the light's coefficients (1, K), each after `sweeps`
        over all regions at once and each alone: from `theta` and a flat light, the first sweep
        without much of the saturated rows (every one is too dark, and materials that spread
        highlights would explain them); and from the material in UNIFORM that has the most evidence
        for all regions, with a light of its own.

        Moves of one material, given the light of others, end at peaks hundreds of nats apart, and
        which is the true one a light of 16 rows cannot always say.
        """
        count = len(self.parts)
        order = lambda: [list(range(count))] + [[r] for r in rng.permutation(count)]
        most, flat = self.parts[0].lobes.most_metallic, self.linear(torch.zeros(self.coded.size))
        materials = [
            (level, m)
            for level, m in {(min(level, len(most) - 1), m) for level, m in UNIFORM}
            if m <= most[level]
        ]
        uniform = max(
            (self.alone(theta.made_of(*material), flat) for material in sorted(materials)),
            key=lambda start: start[0],
        )
        found = [(theta, flat.c, FEW), (*uniform[1:], 1.0)]
        for k, (now, c, weight) in enumerate(found):
            for sweep in range(sweeps):
                self.count_saturated(1.0 if sweep else weight)
                now, c = self.sweep(order(), now, c, rng)
            found[k] = now, c[None]
        return found


def joined(pieces: list[Piece]) -> Theta:
    """The materials of all pieces."""
    return Theta.joined([p.theta for p in pieces])


def light_step(pieces: list[Piece], c: torch.Tensor) -> tuple[torch.Tensor, float]:
    """Newton step (K,) of the light's coefficients at c, and b' H^-1 b / 2 - log det H / 2."""
    factor = cholesky(torch.eye(len(c)) + sum(p.H for p in pieces))
    slope = sum(p.b for p in pieces) - c
    step = torch.cholesky_solve(slope[:, None], factor)[:, 0]
    return step, 0.5 * float(slope @ step) - float(factor.diagonal().log().sum())


def shared(pieces: list[Piece], choices: int) -> float:
    """Log-probability that regions share materials as they do: a Chinese restaurant process (Aldous
    1985), up to a constant.
    """
    have = [(p.theta.level[0], p.theta.m[0]) for p in pieces]
    return sum(np.log1p(choices * have[:r].count(material)) for r, material in enumerate(have))


def damped(c: torch.Tensor, step: torch.Tensor) -> torch.Tensor:
    """c moved by at most 3 deviations of any mode: log light is linear nearby only."""
    return c + step * min(1.0, 3.0 / max(float(step.abs().max()), 1e-9))


def fitted_colour(part: Photos, theta: Theta, U: np.ndarray, W: np.ndarray) -> Theta:
    """The region's Theta with mean and spread of the points' best base colours, U and W (n, 3)
    being what its lobes see.
    """
    out = theta.copy()
    colour = np.clip(
        part.colours(*part.sums(U, part.rest(U, W, out), part.counted(U, W, out)), out)[0],
        1e-3,
        1.2,
    )
    out.mu[0] = np.clip(colour.mean(0), 0.01, 0.95)
    out.tau[0] = np.clip((colour.std(0) / out.mu[0]).mean(), 0.05, 1.5)
    return out
