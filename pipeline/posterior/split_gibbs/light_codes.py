"""The rows' likelihood as a function of unknowns z: a light code and the regions' mean colours.

Light and colours trade against each other and must move together, so z holds both: the code's
unknowns, then the mean colours as numbers q with

    mu = ALBEDO_MAX (1 - exp(-exp q))

which is log mu where mu is small and knows no edge where it is not, scaled so that z ~ N(., w^2)
with the unknowns' width w makes them N(COLOR, COLOR_SPREAD^2). The exact prior of the colours is
part of `value`. PixelUnknowns have a code per pixel; ModeUnknowns the leading modes of the Gaussian
prior about a given code.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import torch

from pipeline.posterior.problem import ALBEDO_MAX
from pipeline.posterior.split_gibbs.likelihood import RowLikelihood, RowsUnder
from pipeline.posterior.split_gibbs.material_prior import log_prior
from pipeline.posterior.split_gibbs.pooling import Fold, Pool, Whole, pooled
from pipeline.prior.gaussian import GaussianPrior
from pipeline.prior.protocol import Prior

# modes of the Gaussian prior: 92 % of its variance
COMPONENTS = 250
# mean and deviation of log base colour in the reference Gaussian of the colours
COLOR, COLOR_SPREAD = np.log(0.3), 0.8


def steepness(color: np.ndarray) -> np.ndarray:
    """d log mu / d q at mean colours (R, 3)."""
    rest = 1 - color / ALBEDO_MAX
    return -np.log(rest) * rest / (1 - rest)


def color_numbers(color: np.ndarray, width: float) -> torch.Tensor:
    """Mean colours (R, 3) as numbers in z, (3, R)."""
    q = torch.from_numpy(np.log(-np.log1p(-color / ALBEDO_MAX)).T.astype(np.float32))
    return (q - COLOR) * (width / COLOR_SPREAD)


def colors_of(numbers: torch.Tensor, width: float) -> np.ndarray:
    """Inverse of `color_numbers`."""
    q = numbers.T.numpy().astype(np.float64) * (COLOR_SPREAD / width) + COLOR
    u = np.exp(np.minimum(q, 10.0))  # e^-e^10 is 0
    return np.clip(-ALBEDO_MAX * np.expm1(-u), 1e-6, ALBEDO_MAX * (1 - 1e-6))


@dataclass(frozen=True)
class Decoder:
    """Codes (3, M) of a prior as radiance, and as the light that the operator acts on.

    gain divides the radiance (light_moves.noise_gain).
    """

    prior: Prior
    pool: Pool
    gain: float = 1.0

    @classmethod
    def onto(cls, prior: Prior, light_rows: int, gain: float = 1.0) -> Decoder:
        """For an operator that resolves `light_rows` rows."""
        return cls(prior, Pool(prior.height, light_rows), gain)

    def radiance(self, code: torch.Tensor, log_scale: float) -> torch.Tensor:
        """(3, M) of a code (3, M)."""
        shape = (1, 3, self.prior.height, self.prior.width)
        factor = float(np.exp(log_scale)) / self.gain
        return factor * self.prior.decode(code.reshape(shape)).reshape(3, -1)

    def map(self, code: torch.Tensor, log_scale: float) -> np.ndarray:
        """`radiance` as a lat-long map (h, 2h, 3), float32."""
        flat = self.radiance(code, log_scale).T
        env = flat.reshape(self.prior.height, self.prior.width, 3).numpy()
        return np.ascontiguousarray(env.astype(np.float32))

    def light(self, code: torch.Tensor, log_scale: float) -> np.ndarray:
        """What the operator acts on, (M', 3)."""
        return self.pooled(self.radiance(code, log_scale))

    def pooled(self, radiance: torch.Tensor) -> np.ndarray:
        """Radiance (3, M) as the operator's light (M', 3)."""
        return self.pool.down(radiance).T.numpy().astype(np.float64)

    def slope(self, code: torch.Tensor, log_scale: float) -> torch.Tensor:
        """Derivative (3, M) of the radiance in the code (3, M); decoding is elementwise."""
        with torch.enable_grad():
            leaf = code.clone().requires_grad_(True)
            (slope,) = torch.autograd.grad(self.radiance(leaf, log_scale).sum(), leaf)
        return slope


@dataclass(frozen=True)
class PixelUnknowns:
    """z (3, M + R): the code of `pixels` = M pixels itself."""

    pixels: int
    width: float

    def join(self, code: torch.Tensor, color: np.ndarray) -> torch.Tensor:
        """z of a code (3, M) and mean colours (R, 3)."""
        return torch.cat([code, color_numbers(color, self.width)], 1)

    def about(self, code: torch.Tensor, regions: int) -> torch.Tensor:
        """What z is drawn about, for a code drawn about `code`."""
        return torch.cat([code, torch.zeros(3, regions)], 1)

    def numbers(self, z: torch.Tensor) -> torch.Tensor:
        """The part of z that stands for colours."""
        return z[:, self.pixels :]

    def colors(self, z: torch.Tensor) -> np.ndarray:
        """Mean colours (R, 3) of z."""
        return colors_of(self.numbers(z), self.width)

    def code(self, z: torch.Tensor) -> torch.Tensor:
        """Code (3, M) of z."""
        return z[:, : self.pixels]

    def gathered(self, code: torch.Tensor, colors: torch.Tensor) -> torch.Tensor:
        """Slopes in the code (3, M) and in the colours' numbers (3, R) as one in z."""
        return torch.cat([code, colors], 1)

    def assembled(
        self, pool: Pool, slope: torch.Tensor, T: torch.Tensor, r: torch.Tensor, V: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor, Fold]:
        """J, r and the fold of an expansion, from the decoder's slope and the rows' T, r, V."""
        fold = Fold(pool, slope, V.shape[2])
        return torch.cat([T * fold.root[:, None], V], 2), r, fold

    def flat(self, r: torch.Tensor) -> torch.Tensor:
        """Residuals (3, n) in the shape of the expansion's: as they are."""
        return r


class Modes:
    """Leading modes of a Gaussian prior, in the codes of `prior`, whose rows the Gaussian's divide;
    `light_rows`: rows of the light that the operator acts on.
    """

    def __init__(self, gaussian: GaussianPrior, prior: Prior, count: int, light_rows: int):
        ratio = gaussian.log_spread / prior.log_spread
        B, variance = gaussian.modes(count)
        self.B = ratio * B  # (K, 3, m)
        self.variance = ratio**2 * variance  # (K,), the squared norms of B
        self.fine = Pool(prior.height, gaussian.height)
        self.coarse = Pool(gaussian.height, light_rows)

    def around(self, mean: torch.Tensor, weighted: torch.Tensor) -> torch.Tensor:
        """Code (3, M): mean (3, M) + sum of weighted (K,) modes."""
        return mean + self.fine.spread(torch.einsum("k,kcm->cm", weighted, self.B))

    def within(self, offset: torch.Tensor) -> torch.Tensor:
        """Weights (K,) of the modes in an offset (3, M) of codes; modes are orthogonal."""
        return torch.einsum("kcm,cm->k", self.B, self.fine.down(offset)) / self.variance

    def along(self, code: torch.Tensor) -> torch.Tensor:
        """Adjoint of `around`'s sum, (K,), of (3, M)."""
        return torch.einsum("kcm,cm->k", self.B, pooled(code, self.fine.shape[0]))

    def moved(self, slope: torch.Tensor) -> torch.Tensor:
        """Change of the operator's light per mode, (3, K, M'), for the decoder's slope (3, M)."""
        coarse = self.fine.down(slope)
        return torch.stack([self.coarse.down(self.B[:, c] * coarse[c]) for c in range(3)])


@dataclass(frozen=True)
class ModeUnknowns:
    """z (1, K + 3 R): coefficients of the modes, N(0, 1), about `mean` (3, M) seen through noise of
    deviation sigma.

    A code x_0 ~ N(., C) seen as x_0 + sigma n has the covariance (C^-1 + sigma^-2)^-1: mode k of
    variance v_k keeps sigma^2 / (v_k + sigma^2) of it, `keep` (K,) is the root of that.
    """

    modes: Modes
    mean: torch.Tensor
    keep: torch.Tensor
    width: float = 1.0

    @classmethod
    def seen(cls, modes: Modes, mean: torch.Tensor, sigma: float = np.inf) -> ModeUnknowns:
        """About a mean seen through noise of deviation sigma; infinite: the prior itself."""
        v = modes.variance
        plain = np.isinf(sigma)
        keep = torch.ones(len(v)) if plain else (sigma**2 / (v + sigma**2)).sqrt()
        return cls(modes, mean, keep)

    @property
    def size(self) -> int:
        """K."""
        return len(self.keep)

    def join(self, coefficients: torch.Tensor, color: np.ndarray) -> torch.Tensor:
        """z of coefficients (1, K) and mean colours (R, 3)."""
        return torch.cat([coefficients, color_numbers(color, self.width).reshape(1, -1)], 1)

    def about(self, coefficients: torch.Tensor, regions: int) -> torch.Tensor:
        """What z is drawn about, for coefficients drawn about `coefficients`."""
        return torch.cat([coefficients, torch.zeros(1, 3 * regions)], 1)

    def coefficients(self, z: torch.Tensor) -> torch.Tensor:
        """(1, K) of z."""
        return z[:, : self.size]

    def nearest(self, code: torch.Tensor) -> torch.Tensor:
        """Coefficients (1, K) whose code is nearest to a code (3, M)."""
        return (self.modes.within(code - self.mean) / self.keep)[None]

    def numbers(self, z: torch.Tensor) -> torch.Tensor:
        """The part of z that stands for colours."""
        return z[:, self.size :]

    def colors(self, z: torch.Tensor) -> np.ndarray:
        """Mean colours (R, 3) of z."""
        return colors_of(self.numbers(z).reshape(3, -1), self.width)

    def code(self, z: torch.Tensor) -> torch.Tensor:
        """Code (3, M) of z, or of coefficients (1, K) alone."""
        return self.modes.around(self.mean, z[0, : self.size] * self.keep)

    def gathered(self, code: torch.Tensor, colors: torch.Tensor) -> torch.Tensor:
        """Slopes in the code (3, M) and in the colours' numbers (3, R) as one in z."""
        return torch.cat([self.keep * self.modes.along(code), colors.reshape(-1)])[None]

    def assembled(
        self, pool: Pool, slope: torch.Tensor, T: torch.Tensor, r: torch.Tensor, V: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor, Whole]:
        """J, r and the fold of an expansion; the three channels are one system, for the modes
        couple them.
        """
        J = torch.einsum("cnm,ckm->cnk", T, self.modes.moved(slope)) * self.keep
        colors = torch.block_diag(*V)
        return torch.cat([J.reshape(-1, self.size), colors], 1)[None], self.flat(r), Whole()

    def flat(self, r: torch.Tensor) -> torch.Tensor:
        """Residuals (3, n) in the shape of the expansion's, (1, 3 n)."""
        return r.reshape(1, -1)


@dataclass(frozen=True)
class CodeLikelihood:
    """Log-likelihood of z (a `gaussian_approximation.LightLikelihood`): rows at the code and the
    colours of z, decoded with a given scale.
    """

    rows: RowLikelihood
    decoder: Decoder
    unknowns: PixelUnknowns | ModeUnknowns
    log_scale: float
    last: list[AtCode] = field(default_factory=list, compare=False)

    def at(self, z: torch.Tensor) -> AtCode:
        """The likelihood about z; that of the last z is remembered, for a step asks for the value,
        the residual and the slope at the same one.
        """
        if not self.last or self.last[0].z is not z:
            self.last[:] = [AtCode(self, z)]
        return self.last[0]

    def value(self, z: torch.Tensor) -> float:
        """Log-likelihood and exact prior of the colours, less the reference Gaussian's."""
        here, width = self.at(z).under, self.unknowns.width
        materials, roughness = here.rows.materials, here.rows.data.lobes.roughness
        prior = log_prior(materials, roughness) + float(np.log(steepness(materials.color)).sum())
        reference = 0.5 * float(self.unknowns.numbers(z).square().sum()) / width**2
        return here.value() + prior + reference

    def residual(self, z: torch.Tensor) -> torch.Tensor:
        """Of `expansion`."""
        return self.unknowns.flat(self.at(z).under.residual)

    def adjoint(self, z: torch.Tensor, w: torch.Tensor) -> torch.Tensor:
        """Of `expansion`, for w like its residual: like z."""
        here = self.at(z)
        light, colors = here.under.adjoint(w.reshape(3, -1))
        slope = self.decoder.pool.up(light) * here.slope
        return self.unknowns.gathered(slope, colors * here.color_slope)

    def expansion(self, z: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, Fold | Whole]:
        """Gauss-Newton: J, r and fold, see `gaussian_approximation.LightLikelihood`."""
        here = self.at(z)
        T, r, V = here.under.expansion()
        scaled = V * here.color_slope[:, None]
        return self.unknowns.assembled(self.decoder.pool, here.slope, T, r, scaled)


@dataclass(frozen=True)
class AtCode:
    """A CodeLikelihood about one z: what its parts share is worked out once."""

    likelihood: CodeLikelihood
    z: torch.Tensor

    @cached_property
    def under(self) -> RowsUnder:
        """The rows with the colours of z, about its light."""
        known = self.likelihood
        rows = known.rows.recolored(known.unknowns.colors(self.z))
        code = known.unknowns.code(self.z)
        return rows.under(known.decoder.light(code, known.log_scale))

    @cached_property
    def slope(self) -> torch.Tensor:
        """Of the radiance in the code, (3, M)."""
        known = self.likelihood
        return known.decoder.slope(known.unknowns.code(self.z), known.log_scale)

    @cached_property
    def color_slope(self) -> torch.Tensor:
        """d log mu / d z of the colours' numbers, (3, R)."""
        steep = torch.from_numpy(steepness(self.under.rows.materials.color).T.astype(np.float32))
        return steep * (COLOR_SPREAD / self.likelihood.unknowns.width)
