"""Posterior samples by split Gibbs sampling with a diffusion prior (PnP-DM: Wu et al. 2024; DAPS:
Zhang et al. 2025).

The light's code is split in two that attract each other, pi(x, z) ~ p(x) exp(-|x - z|^2 / 2 rho^2)
l(z), and rho falls from a level's width of the prior to almost nothing. In turn:

    z | x    the likelihood in code space with a Gaussian around x: elliptical slice sampling
    (Murray et al. 2010) about
             the Laplace approximation
    x | z    the prior seen through noise of width rho: the network's own reverse diffusion from
    level rho down the rest the regions' materials, the light's scale, the noise (region_moves.py,
    likelihood.py)

The network is never differentiated, and all steps leave the augmented posterior as it is (up to the
levels of the reverse diffusion), so there is no guidance weight to tune.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
import torch
from scipy.linalg.blas import ssyrk

# at most; fewer when a step gains less than NEWTON_GAIN per unknown: draws vary by 1/2 per unknown
NEWTON_STEPS = 12
PERTURBED_STEPS = 3  # at most from the peak to that of perturbed data
NEWTON_GAIN = 0.01
# a step with an old curvature gains at most so much of the one before, or the curvature is made
# anew
CONTRACTION = 0.5
DAMPING, DAMPING_LIMIT = 6.0, 1e10  # factor between attempts at a step; where they end
# damping from which a small gain means an edge (a saturated row begins or ceases to count), not a
# curved valley
KINK = 1e5
SLICES = 6


class LightLikelihood(Protocol):
    """Log-likelihood of a light code z (3, M)."""

    def value(self, z: torch.Tensor) -> float: ...

    def residual(self, z: torch.Tensor) -> torch.Tensor:
        """r (3, n) of `expansion` alone."""

    def expansion(self, z: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, object]:
        """J (3, n, k), r (3, n) and a fold E (pooling.py): log-likelihood of z + d ~ -|r - J E d|^2
        / 2, channel by channel.
        """

    def adjoint(self, z: torch.Tensor, w: torch.Tensor) -> torch.Tensor:
        """E^T J^T w of `expansion`, like z, for w (3, n); likelihoods that need not build J for it
        override this.
        """
        J, _, fold = self.expansion(z)
        return transposed(J, fold, w)


def transposed(J: torch.Tensor, fold, w: torch.Tensor) -> torch.Tensor:
    """E^T J^T w for w (3, n)."""
    return fold.up(torch.einsum("cnk,cn->ck", J, w))


def noise_gain(spread: float, rho: float) -> float:
    """Mean factor by which code noise of width rho raises radiance exp(spread x + ...): exp((spread
    rho)^2 / 2).

    z is x plus such noise; without dividing by this, x has to be too dark for z to be right, and
    lags behind as rho falls.
    """
    return float(np.exp(0.5 * (spread * rho) ** 2))


def widths(levels: int, first: float, last: float, stay: int) -> np.ndarray:
    """The rho of every turn: geometric from `first` to `last`, then `stay` more turns at `last`."""
    return np.concatenate([np.geomspace(first, last, levels), np.full(stay, last)])


def cholesky(A: torch.Tensor) -> torch.Tensor:
    """Of a positive definite matrix; a little more diagonal where rounding asks for it."""
    for jitter in (0.0, 1e-6, 1e-5, 1e-4, 1e-3):
        factor, bad = torch.linalg.cholesky_ex(A + jitter * A.diagonal().mean() * torch.eye(len(A)))
        if not bad:
            return factor
    raise FloatingPointError("the light's curvature is not positive definite")


def gram(J: torch.Tensor) -> torch.Tensor:
    """J J^T of one matrix: half the work of a product."""
    G = torch.from_numpy(ssyrk(1.0, J.numpy().T, trans=1))  # Fortran order: upper triangle only
    return G + G.triu(1).T


class Curvature:
    """A = J^T J + I / s^2 of one channel, J (n, M): solved in whichever of the two spaces is
    smaller (Woodbury).
    """

    def __init__(self, J: torch.Tensor, s: float):
        self.J, self.dual = J, J.shape[0] < J.shape[1]
        self.inner = gram(J) if self.dual else gram(J.T.contiguous())
        self.set(s)

    def set(self, s: float) -> None:
        """Another s, the same J."""
        self.s, self.factor = s, cholesky(s**2 * self.inner + torch.eye(len(self.inner)))

    def solve(self, b: torch.Tensor) -> torch.Tensor:
        """A^-1 b, (M,)"""
        if not self.dual:
            return self.s**2 * torch.cholesky_solve(b[:, None], self.factor)[:, 0]
        inner = torch.cholesky_solve((self.J @ b)[:, None], self.factor)[:, 0]
        return self.s**2 * (b - self.s**2 * (inner @ self.J))

    def draw(self, noise: torch.Generator) -> torch.Tensor:
        """A draw of N(0, A^-1), by perturbing and solving (Papandreou and Yuille 2010)."""
        a, b = (
            torch.randn(self.J.shape[1], generator=noise),
            torch.randn(self.J.shape[0], generator=noise),
        )
        return self.solve(a / self.s + b @ self.J)


class Laplace:
    """Gaussian N(mode, A^-1) near the peak of likelihood x N(z; x, rho^2), channels independent; z
    is where to begin.

    `noise` (3, n): whitened data are moved by it. `known`: another peak nearby, whose A will do as
    long as steps with it converge.
    """

    def __init__(
        self,
        likelihood: LightLikelihood,
        x: torch.Tensor,
        z: torch.Tensor,
        rho: float,
        noise: torch.Tensor | None = None,
        known: Laplace | None = None,
    ):
        self.mode, self.rho, self.damping = z.clone(), rho, 0.0
        moved = lambda t: 0.0 if noise is None else float((noise * likelihood.residual(t)).sum())
        target = lambda t: (
            likelihood.value(t) - moved(t) - 0.5 * float((t - x).square().sum()) / rho**2
        )
        data = lambda r: r if noise is None else r + noise
        slope = lambda pulled: pulled - (self.mode - x) / rho**2
        pulled = lambda: slope(likelihood.adjoint(self.mode, data(likelihood.residual(self.mode))))
        now, enough = target(self.mode), NEWTON_GAIN * z.numel()
        if known:
            self.J, self.fold, self.curvature = known.J, known.fold, known.curvature
            settled, now = self.chords(target, now, pulled, enough)
            if settled:
                return
        for _ in range(NEWTON_STEPS if noise is None else PERTURBED_STEPS):
            self.J, r, self.fold = likelihood.expansion(self.mode)
            self.damping = self.damping / DAMPING if self.damping > 1 else 0.0
            self.curvature = [Curvature(J, self.width) for J in self.J]
            gain, now = self.climb(target, now, slope(transposed(self.J, self.fold, data(r))))
            if gain == 0 or (gain < enough and not 1 < self.damping < KINK):
                break
            if self.damping == 0:
                settled, now = self.chords(target, now, pulled, enough)
                if settled:
                    break
        self.damp(0.0)

    def chords(self, target, now: float, slope, enough: float) -> tuple[bool, float]:
        """Newton steps with the A at hand, as long as each gains much less than the one before:
        whether they came to less than `enough`, and the target there.
        """
        before = np.inf
        while True:
            step = self.solve(slope())
            then = target(self.mode + step)
            gain = then - now
            if gain <= 0:
                return -gain < enough, now
            self.mode, now = self.mode + step, then
            if gain < enough or gain > CONTRACTION * before:
                return gain < enough, now
            before = gain

    @property
    def width(self) -> float:
        """rho, smaller under damping."""
        return self.rho / np.sqrt(1 + self.damping)

    def damp(self, damping: float) -> None:
        if damping != self.damping:
            self.damping = damping
            for A in self.curvature:
                A.set(self.width)

    def climb(self, target, now: float, slope: torch.Tensor) -> tuple[float, float]:
        """A step of Levenberg (1944) and Marquardt, uphill or none: its gain and the new target."""
        while True:
            step = self.solve(slope)
            then = target(self.mode + step)
            if then > now:
                self.mode = self.mode + step
                return then - now, then
            if self.damping > DAMPING_LIMIT:
                return 0.0, now
            self.damp(max(1.0, DAMPING * self.damping))

    def beside(self, z: torch.Tensor) -> torch.Tensor:
        """The part of z (3, M) of which the photos say nothing."""
        return z - self.fold.up(self.fold.down(z))

    def solve(self, b: torch.Tensor) -> torch.Tensor:
        """A^-1 b, (3, M)."""
        inner = torch.stack([A.solve(v) for A, v in zip(self.curvature, self.fold.down(b))])
        return self.width**2 * self.beside(b) + self.fold.up(inner)

    def draw(self, noise: torch.Generator) -> torch.Tensor:
        """A draw of N(0, A^-1), (3, M)."""
        inner = torch.stack([A.draw(noise) for A in self.curvature])
        return self.rho * self.beside(torch.randn(self.mode.shape, generator=noise)) + self.fold.up(
            inner
        )

    def image(self, offset: torch.Tensor) -> torch.Tensor:
        """J E offset (3, n)."""
        return torch.stack([J @ d for J, d in zip(self.J, self.fold.down(offset))])

    def energy(self, offset: torch.Tensor, image: torch.Tensor) -> float:
        """offset^T A offset / 2, given its image."""
        return 0.5 * (float(offset.square().sum()) / self.rho**2 + float(image.square().sum()))


def elliptical_slice(
    z: torch.Tensor, target, reference: Laplace, slices: int, rng, noise
) -> torch.Tensor:
    """`slices` steps that leave exp(target) unchanged; `reference` only decides how well they mix
    (Nishihara et al. 2014).
    """
    offset = z - reference.mode
    image = reference.image(offset)
    now = target(z) + reference.energy(offset, image)
    for _ in range(slices):
        level, fresh = now + np.log(rng.random()), reference.draw(noise)
        fresh_image, angle = reference.image(fresh), rng.uniform(0, 2 * np.pi)
        low, high = angle - 2 * np.pi, angle
        while True:
            c, s = np.cos(angle), np.sin(angle)
            turned, turned_image = c * offset + s * fresh, c * image + s * fresh_image
            then = target(reference.mode + turned) + reference.energy(turned, turned_image)
            if then > level:
                offset, image, now = turned, turned_image, then
                break
            low, high = (angle, high) if angle < 0 else (low, angle)
            if high - low < 1e-6:  # numerically back at z
                break
            angle = rng.uniform(low, high)
    return reference.mode + offset


def draw_light(
    likelihood: LightLikelihood,
    x: torch.Tensor,
    z: torch.Tensor,
    rho: float,
    slices: int,
    rng,
    noise,
) -> torch.Tensor:
    """z | x: codes (3, M), by randomised maximum likelihood (Oliver et al. 1996; Bardsley et al.
    2014: perturb data and prior mean, then optimise), exact where log-likelihood is quadratic, and
    slices from there. z is where to look for the peak.

    Slices alone turn by small angles where the Gaussian about the peak is a poor one: they do not
    get round in a few turns.
    """
    reference = Laplace(likelihood, x, z, rho)
    target = lambda t: likelihood.value(t) - 0.5 * float((t - x).square().sum()) / rho**2
    fresh = lambda shape: torch.randn(shape, generator=noise)
    z = Laplace(
        likelihood,
        x + rho * fresh(x.shape),
        reference.mode,
        rho,
        fresh(reference.J.shape[:2]),
        known=reference,
    ).mode
    return elliptical_slice(z, target, reference, slices, rng, noise)


def prior_steps(rho: float) -> int:
    """Network calls of x | z: more where the gap is wide."""
    return int(np.clip(round(4 + 4 * np.log10(rho / 0.02)), 3, 14))
