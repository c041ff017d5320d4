"""The photos' likelihood as a function of a light code and the regions' mean colours
(split_gibbs.LightLikelihood).

Light and colours trade against each other and must move together, so that z holds both: the code's
unknowns, then the mean colours as numbers q with mu = ALBEDO_MAX (1 - exp(-exp q)), which is log mu
where mu is small and knows no edge where it is not, scaled so that z ~ N(., width^2) makes them
N(COLOUR, COLOUR_SPREAD^2). The exact prior of the colours is part of `value`. PixelCode has a code
per pixel; ModeCode the leading modes of the Gaussian prior around a given code.
"""

from __future__ import annotations

import numpy as np
import torch

from pipeline.posterior.problem import ALBEDO_MAX
from pipeline.posterior.split_gibbs.likelihood import Photos, Theta
from pipeline.posterior.split_gibbs.material_moves import log_prior
from pipeline.posterior.split_gibbs.pooling import Fold, Pool, Whole, pooled
from pipeline.prior.gaussian import GaussianPrior

COMPONENTS = 400  # modes of the Gaussian prior: 95 % of its variance
COLOUR, COLOUR_SPREAD = (
    np.log(0.3),
    0.8,
)  # mean and deviation of log base colour in the reference Gaussian of the colours


def steepness(mu: np.ndarray) -> np.ndarray:
    """d log mu / d q."""
    rest = 1 - mu / ALBEDO_MAX
    return -np.log(rest) * rest / (1 - rest)


class Coded:
    """What both share. z is (rows, size + colours); `gain` divides the radiance
    (split_gibbs.noise_gain).
    """

    def __init__(self, photos: Photos, prior, log_scale: float, width: float):
        self.photos, self.prior, self.log_scale, self.width, self.gain = (
            photos,
            prior,
            log_scale,
            width,
            1.0,
        )
        self.pool = Pool(prior.height, photos.transport.h)

    def radiance(self, code: torch.Tensor) -> torch.Tensor:
        """(3, M) of a code (3, M)"""
        shape = (1, 3, self.prior.height, self.prior.width)
        return (
            float(np.exp(self.log_scale))
            / self.gain
            * self.prior.decode(code.reshape(shape)).reshape(3, -1)
        )

    def map(self, code: torch.Tensor) -> np.ndarray:
        """`radiance` as a lat-long map (h, 2h, 3), float32."""
        return np.ascontiguousarray(
            self.radiance(code)
            .T.reshape(self.prior.height, self.prior.width, 3)
            .numpy()
            .astype(np.float32)
        )

    def light(self, code: torch.Tensor) -> np.ndarray:
        """What the operator acts on, (M', 3)."""
        return self.pool.down(self.radiance(code)).T.numpy().astype(np.float64)

    def slopes(self, code: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Radiance (3, M) and its derivative in the code (3, M)."""
        with torch.enable_grad():
            leaf = code.clone().requires_grad_(True)
            L = self.radiance(leaf)
            (g,) = torch.autograd.grad(L.sum(), leaf)  # decoding is elementwise
        return L.detach(), g

    def scaled(self, mu: np.ndarray) -> torch.Tensor:
        """Colours (R, 3) as numbers in z, (3, R)."""
        q = torch.from_numpy(np.log(-np.log1p(-mu / ALBEDO_MAX)).T.astype(np.float32))
        return (q - COLOUR) * (self.width / COLOUR_SPREAD)

    def unscaled(self, numbers: torch.Tensor) -> np.ndarray:
        """Inverse of `scaled`."""
        u = np.exp(
            np.minimum(
                numbers.T.numpy().astype(np.float64) * (COLOUR_SPREAD / self.width) + COLOUR, 10.0
            )
        )  # e^-e^10 is 0
        return np.clip(-ALBEDO_MAX * np.expm1(-u), 1e-6, ALBEDO_MAX * (1 - 1e-6))

    def put(self, z: torch.Tensor) -> Theta:
        """The photos get the colours of z."""
        theta = self.photos.theta.copy()
        theta.mu = self.colours(z)
        self.photos.set(theta)
        return theta

    def value(self, z: torch.Tensor) -> float:
        theta = self.put(z)
        prior = log_prior(theta) + float(np.log(steepness(theta.mu)).sum())
        return (
            self.photos.value(self.light(self.code(z)))
            + prior
            + 0.5 * float(z[:, self.size :].square().sum()) / self.width**2
        )

    def residual(self, z: torch.Tensor) -> torch.Tensor:
        """Of `expansion`, (3, n)."""
        self.put(z)
        return self.photos.residual(self.light(self.code(z)))

    def pulled(self, z: torch.Tensor, w: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Adjoint of the expansion in the code (3, M) and in the scaled colours (3, R), for w (3,
        n).
        """
        steep = torch.from_numpy(steepness(self.put(z).mu).T.astype(np.float32))
        L, g = self.slopes(self.code(z))
        light, colours = self.photos.adjoint(self.pool.down(L).T.numpy().astype(np.float64), w)
        return self.pool.up(light) * g, colours * steep * (COLOUR_SPREAD / self.width)

    def linear(self, z: torch.Tensor):
        """Slope g (3, M), T (3, n, M'), residual (3, n), V (3, n, R) at z."""
        steep = torch.from_numpy(steepness(self.put(z).mu).T[:, None].astype(np.float32))
        L, g = self.slopes(self.code(z))
        T, residual, V = self.photos.whitened(self.pool.down(L).T.numpy().astype(np.float64))
        return g, T, residual, V * steep * (COLOUR_SPREAD / self.width)


class PixelCode(Coded):
    """z (3, M + R): the code itself."""

    @property
    def size(self) -> int:
        return self.prior.height * self.prior.width

    def join(self, code: torch.Tensor, theta: Theta) -> torch.Tensor:
        """z of a code (3, M) and colours."""
        return torch.cat([code, self.scaled(theta.mu)], 1)

    def centre(self, code: torch.Tensor) -> torch.Tensor:
        """What z is drawn about, for a code drawn about `code`."""
        return torch.cat([code, torch.zeros(3, len(self.photos.theta.m))], 1)

    def colours(self, z: torch.Tensor) -> np.ndarray:
        return self.unscaled(z[:, self.size :])

    def code(self, z: torch.Tensor) -> torch.Tensor:
        return z[:, : self.size]

    def adjoint(self, z: torch.Tensor, w: torch.Tensor) -> torch.Tensor:
        return torch.cat(self.pulled(z, w), 1)

    def expansion(self, z: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, Fold]:
        """Gauss-Newton."""
        g, T, residual, V = self.linear(z)
        fold = Fold(self.pool, g, V.shape[2])
        return torch.cat([T * fold.root[:, None], V], 2), residual, fold


class Modes:
    """Leading modes of a Gaussian prior, in the codes of `prior`, whose rows the Gaussian's divide;
    `operator`: rows of the light that T acts on.
    """

    def __init__(self, gaussian: GaussianPrior, prior, count: int, operator: int):
        ratio = gaussian.log_spread / prior.log_spread
        B, variance = gaussian.modes(count)
        self.B, self.variance = (
            ratio * B,
            ratio**2 * variance,
        )  # (K, 3, m); (K,), the squared norms of B
        self.fine, self.coarse = (
            Pool(prior.height, gaussian.height),
            Pool(gaussian.height, operator),
        )

    def around(self, mean: torch.Tensor, weighted: torch.Tensor) -> torch.Tensor:
        """Code (3, M): mean (3, M) + sum of weighted (K,) modes."""
        return mean + self.fine.spread(torch.einsum("k,kcm->cm", weighted, self.B))

    def within(self, offset: torch.Tensor) -> torch.Tensor:
        """Weights (K,) of the modes in an offset (3, M) of codes; modes are orthogonal."""
        return torch.einsum("kcm,cm->k", self.B, self.fine.down(offset)) / self.variance

    def along(self, code: torch.Tensor) -> torch.Tensor:
        """Adjoint of `around`'s sum, (K,), of (3, M)."""
        return torch.einsum("kcm,cm->k", self.B, pooled(code, self.fine.shape[0]))

    def moved(self, g: torch.Tensor) -> torch.Tensor:
        """Change of the operator's light per mode, (3, K, M'), for slopes g (3, M)."""
        slope = self.fine.down(g)
        return torch.stack([self.coarse.down(self.B[:, c] * slope[c]) for c in range(3)])


class ModeCode(Coded):
    """z (1, K + 3 R): coefficients of the modes, N(0, 1), about `mean` (3, M) seen through noise of
    deviation sigma.

    A code x_0 ~ N(., C) seen as x_0 + sigma n has the covariance (C^-1 + sigma^-2)^-1: mode k keeps
    sigma^2 / (v_k + sigma^2).
    """

    def __init__(
        self,
        photos: Photos,
        prior,
        log_scale: float,
        modes: Modes,
        mean: torch.Tensor,
        sigma: float = np.inf,
    ):
        super().__init__(photos, prior, log_scale, 1.0)
        self.modes, self.mean, self.size = modes, mean, len(modes.variance)
        self.keep = (
            torch.ones(self.size)
            if np.isinf(sigma)
            else (sigma**2 / (modes.variance + sigma**2)).sqrt()
        )

    def join(self, c: torch.Tensor, theta: Theta) -> torch.Tensor:
        """z of coefficients (1, K) and colours."""
        return torch.cat([c, self.scaled(theta.mu).reshape(1, -1)], 1)

    def centre(self, c: torch.Tensor) -> torch.Tensor:
        return torch.cat([c, torch.zeros(1, 3 * len(self.photos.theta.m))], 1)

    def colours(self, z: torch.Tensor) -> np.ndarray:
        return self.unscaled(z[:, self.size :].reshape(3, -1))

    def code(self, z: torch.Tensor) -> torch.Tensor:
        return self.modes.around(self.mean, z[0, : self.size] * self.keep)

    def coefficients(self, code: torch.Tensor) -> torch.Tensor:
        """(1, K) whose `code` is nearest to a code (3, M)."""
        return (self.modes.within(code - self.mean) / self.keep)[None]

    def adjoint(self, z: torch.Tensor, w: torch.Tensor) -> torch.Tensor:
        code, colours = self.pulled(z, w.reshape(3, -1))
        return torch.cat([self.keep * self.modes.along(code), colours.reshape(-1)])[None]

    def expansion(self, z: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, Whole]:
        """Gauss-Newton; the three channels are one system, for the modes couple them."""
        g, T, residual, V = self.linear(z)
        J = torch.einsum("cnm,ckm->cnk", T, self.modes.moved(g)) * self.keep
        colours = torch.block_diag(*V)
        return (
            torch.cat([J.reshape(-1, self.size), colours], 1)[None],
            residual.reshape(1, -1),
            Whole(),
        )

    def residual(self, z: torch.Tensor) -> torch.Tensor:
        return super().residual(z).reshape(1, -1)
