"""The peak of likelihood x N(z; x, rho^2) and the Gaussian about it.

Letters: z (C, M) unknowns of C independent channels; J (C, n, k), r (C, n) and a fold E
(pooling.py) expand the log-likelihood about z: that of z + d is ~ -|r - J E d|^2 / 2. The Gaussian
has the precision A = E' J' J E + I / rho^2, channel by channel.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
import torch
from scipy.linalg.blas import ssyrk

# at most; fewer when a step gains less than NEWTON_GAIN per unknown: draws vary by 1/2 per unknown
NEWTON_STEPS = 12
# at most from the peak to that of perturbed data
PERTURBED_STEPS = 3
NEWTON_GAIN = 0.01
# a step with an old curvature gains at most so much of the one before, or it is made anew
CONTRACTION = 0.5
# factor between attempts at a step; where they end
DAMPING, DAMPING_LIMIT = 6.0, 1e10
# damping from which a small gain means an edge (a saturated row begins or ceases to count), not a
# curved valley
KINK = 1e5


class Folding(Protocol):
    """E: from all unknowns (C, M) to those the photos bind (C, k); its rows are orthonormal."""

    def down(self, z: torch.Tensor) -> torch.Tensor:
        """E z."""
        ...

    def up(self, u: torch.Tensor) -> torch.Tensor:
        """E' u."""
        ...


class LightLikelihood(Protocol):
    """Log-likelihood of unknowns z."""

    def value(self, z: torch.Tensor) -> float:
        """Of z."""
        ...

    def residual(self, z: torch.Tensor) -> torch.Tensor:
        """r (C, n) of `expansion` alone."""
        ...

    def expansion(self, z: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, Folding]:
        """J (C, n, k), r (C, n) and a fold E: log-likelihood of z + d ~ -|r - J E d|^2 / 2."""
        ...

    def adjoint(self, z: torch.Tensor, w: torch.Tensor) -> torch.Tensor:
        """E' J' w of `expansion`, like z, for w (C, n); likelihoods that need not build J for it
        override this.
        """
        J, _, fold = self.expansion(z)
        return transposed(J, fold, w)


def transposed(J: torch.Tensor, fold: Folding, w: torch.Tensor) -> torch.Tensor:
    """E' J' w for w (C, n)."""
    return fold.up(torch.einsum("cnk,cn->ck", J, w))


def cholesky(A: torch.Tensor) -> torch.Tensor:
    """Of a positive definite matrix, by its lower triangle; a little more diagonal where rounding
    asks for it.
    """
    for jitter in (0.0, 1e-6, 1e-5, 1e-4, 1e-3):
        more = jitter * A.diagonal().mean()
        factor, bad = torch.linalg.cholesky_ex(A + more * torch.eye(len(A)) if jitter else A)
        if not bad:
            return factor
    raise FloatingPointError("the light's curvature is not positive definite")


def gram(J: torch.Tensor) -> torch.Tensor:
    """The lower triangle of J J', zero above: half the work of a product."""
    return torch.from_numpy(ssyrk(1.0, J.numpy().T, trans=1, lower=1))


@dataclass(frozen=True)
class Curvature:
    """A = J' J + I / s^2 of one channel, J (n, k): solved in whichever of the two spaces is smaller
    (Woodbury). inner: the lower triangle of J' J there, or of J J'.
    """

    J: torch.Tensor
    inner: torch.Tensor
    factor: torch.Tensor
    s: float

    @classmethod
    def of(cls, J: torch.Tensor, s: float) -> Curvature:
        """Of J (n, k) and s."""
        dual = J.shape[0] < J.shape[1]
        inner = gram(J) if dual else gram(J.T.contiguous())
        return cls(J, inner, factor_of(inner, s), s)

    def at(self, s: float) -> Curvature:
        """Another s, the same J."""
        return replace(self, s=s, factor=factor_of(self.inner, s))

    @property
    def dual(self) -> bool:
        """Whether the space of the rows is the smaller one."""
        return self.J.shape[0] < self.J.shape[1]

    def solve(self, b: torch.Tensor) -> torch.Tensor:
        """A^-1 b, (k,)."""
        if not self.dual:
            return self.s**2 * torch.cholesky_solve(b[:, None], self.factor)[:, 0]
        inner = torch.cholesky_solve((self.J @ b)[:, None], self.factor)[:, 0]
        return self.s**2 * (b - self.s**2 * (inner @ self.J))

    def draw(self, noise: torch.Generator) -> torch.Tensor:
        """A draw of N(0, A^-1), by perturbing and solving (Papandreou and Yuille 2010)."""
        a = torch.randn(self.J.shape[1], generator=noise)
        b = torch.randn(self.J.shape[0], generator=noise)
        return self.solve(a / self.s + b @ self.J)


def factor_of(inner: torch.Tensor, s: float) -> torch.Tensor:
    """Cholesky factor of s^2 inner + I."""
    A = s**2 * inner
    A.diagonal().add_(1)
    return cholesky(A)


@dataclass(frozen=True)
class GaussianApproximation:
    """N(mode, A^-1) about a peak; with damping the precision is that of a smaller rho."""

    mode: torch.Tensor
    rho: float
    J: torch.Tensor
    fold: Folding
    curvature: tuple[Curvature, ...]
    damping: float = 0.0

    @property
    def width(self) -> float:
        """rho, smaller under damping."""
        return damped_width(self.rho, self.damping)

    def damped(self, damping: float) -> GaussianApproximation:
        """The same under another damping."""
        if damping == self.damping:
            return self
        width = damped_width(self.rho, damping)
        curvature = tuple(A.at(width) for A in self.curvature)
        return replace(self, damping=damping, curvature=curvature)

    def moved_to(self, mode: torch.Tensor) -> GaussianApproximation:
        """The same curvature about another point."""
        return replace(self, mode=mode)

    def beside(self, z: torch.Tensor) -> torch.Tensor:
        """The part of z (C, M) of which the photos say nothing."""
        return z - self.fold.up(self.fold.down(z))

    def solve(self, b: torch.Tensor) -> torch.Tensor:
        """A^-1 b, (C, M)."""
        channels = zip(self.curvature, self.fold.down(b))
        inner = torch.stack([A.solve(v) for A, v in channels])
        return self.width**2 * self.beside(b) + self.fold.up(inner)

    def draw(self, noise: torch.Generator) -> torch.Tensor:
        """A draw of N(0, A^-1), (C, M)."""
        inner = torch.stack([A.draw(noise) for A in self.curvature])
        free = torch.randn(self.mode.shape, generator=noise)
        return self.rho * self.beside(free) + self.fold.up(inner)

    def image(self, offset: torch.Tensor) -> torch.Tensor:
        """J E offset (C, n)."""
        return torch.stack([J @ d for J, d in zip(self.J, self.fold.down(offset))])

    def energy(self, offset: torch.Tensor, image: torch.Tensor) -> float:
        """offset' A offset / 2, given its image."""
        return 0.5 * (float(offset.square().sum()) / self.rho**2 + float(image.square().sum()))


def damped_width(rho: float, damping: float) -> float:
    """rho / sqrt(1 + damping)."""
    return rho / np.sqrt(1 + damping)


@dataclass(frozen=True)
class Hill:
    """What is climbed: log likelihood x N(z; x, rho^2), the whitened data moved by `noise` (C, n)
    if given.
    """

    likelihood: LightLikelihood
    x: torch.Tensor
    rho: float
    noise: torch.Tensor | None

    def height(self, z: torch.Tensor) -> float:
        """Log-density of z up to a constant."""
        moved = 0.0
        value = self.likelihood.value(z)
        if self.noise is not None:
            moved = float((self.noise * self.likelihood.residual(z)).sum())
        return value - moved - 0.5 * float((z - self.x).square().sum()) / self.rho**2

    def moved(self, r: torch.Tensor) -> torch.Tensor:
        """Residuals of the moved data."""
        return r if self.noise is None else r + self.noise

    def slope(self, z: torch.Tensor, pulled: torch.Tensor) -> torch.Tensor:
        """Slope at z, where the data pull by `pulled`."""
        return pulled - (z - self.x) / self.rho**2

    def slope_at(self, z: torch.Tensor) -> torch.Tensor:
        """Slope at z, without building J."""
        r = self.moved(self.likelihood.residual(z))
        return self.slope(z, self.likelihood.adjoint(z, r))


def approximate(
    likelihood: LightLikelihood,
    x: torch.Tensor,
    z: torch.Tensor,
    rho: float,
    noise: torch.Tensor | None = None,
    known: GaussianApproximation | None = None,
) -> GaussianApproximation:
    """Gaussian about the peak of likelihood x N(z; x, rho^2), begun at z, by Levenberg (1944) and
    Marquardt's steps: a Gauss-Newton step in log radiance overshoots wherever a lamp has to grow.

    noise (C, n): whitened data are moved by it. known: the Gaussian about another peak nearby,
    whose curvature will do as long as steps with it converge.
    """
    hill = Hill(likelihood, x, rho, noise)
    mode, damping = z.clone(), 0.0
    height = hill.height(mode)
    enough = NEWTON_GAIN * z.numel()

    if known is not None:
        at = replace(known, mode=mode, rho=rho, damping=0.0)
        settled, at, height = chords(hill, at, height, enough)
        mode = at.mode
        if settled:
            return at

    for _ in range(NEWTON_STEPS if noise is None else PERTURBED_STEPS):
        J, r, fold = likelihood.expansion(mode)
        damping = damping / DAMPING if damping > 1 else 0.0
        width = damped_width(rho, damping)
        curvature = tuple(Curvature.of(of_channel, width) for of_channel in J)
        at = GaussianApproximation(mode, rho, J, fold, curvature, damping)

        slope = hill.slope(mode, transposed(J, fold, hill.moved(r)))
        gain, at, height = climb(hill, at, height, slope)
        mode, damping = at.mode, at.damping
        if gain == 0 or (gain < enough and not 1 < damping < KINK):
            break
        if damping == 0:
            settled, at, height = chords(hill, at, height, enough)
            mode = at.mode
            if settled:
                break
    return at.damped(0.0)


def chords(
    hill: Hill, at: GaussianApproximation, height: float, enough: float
) -> tuple[bool, GaussianApproximation, float]:
    """Newton steps with the curvature at hand, as long as each gains much less than the one before.

    Returns whether they came to less than `enough`, where, and the height there.
    """
    before = np.inf
    while True:
        mode = at.mode + at.solve(hill.slope_at(at.mode))
        then = hill.height(mode)
        gain = then - height
        if gain <= 0:
            return -gain < enough, at, height
        at, height = at.moved_to(mode), then
        if gain < enough or gain > CONTRACTION * before:
            return gain < enough, at, height
        before = gain


def climb(
    hill: Hill, at: GaussianApproximation, height: float, slope: torch.Tensor
) -> tuple[float, GaussianApproximation, float]:
    """A step uphill or none, under as much damping as it needs: its gain, where, and the height."""
    while True:
        mode = at.mode + at.solve(slope)
        then = hill.height(mode)
        if then > height:
            return then - height, at.moved_to(mode), then
        if at.damping > DAMPING_LIMIT:
            return 0.0, at, height
        at = at.damped(max(1.0, DAMPING * at.damping))
