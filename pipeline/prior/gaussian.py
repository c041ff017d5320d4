"""The Gaussian prior: natural light as a normal distribution of codes, stationary in yaw, symmetric
under mirroring.

Fourier transform over longitude makes the covariance block-diagonal: one (h, h) matrix per
frequency and opponent colour channel, estimated from the same maps as the diffusion prior.
Denoising is closed form, E[x | x + sigma n], which makes it the yardstick that samplers are held
against; its leading eigenvectors are a smooth basis for light.

Letters of the sums: n a map, c a colour, o an opponent channel, h and g rows, w a column, k a
frequency, e an eigenvector.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import torch

from pipeline.prior.protocol import Prior
from pipeline.prior.value_code import Code

OPPONENT = (
    torch.tensor([[1.0, 1, 1], [1, 0, -1], [1, -2, 1]]) / torch.tensor([3.0, 2, 6]).sqrt()[:, None]
)
SHRINK = 0.02  # share of the mean variance added to every diagonal: few maps, many entries


def spectra(codes: np.ndarray, weights: np.ndarray) -> tuple[torch.Tensor, torch.Tensor]:
    """Row means (3, h) in RGB and covariances (3, w / 2 + 1, h, h) per opponent channel and
    frequency, of codes (n, 3, h, w).

    In units where white noise of variance v has the identity times v at every frequency.
    """
    x = torch.from_numpy(codes).double()
    weight = torch.from_numpy(weights / weights.sum()).double()
    mean = torch.einsum("n,nchw->ch", weight, x) / x.shape[-1]

    centred = torch.einsum("oc,nchw->nohw", OPPONENT.double(), x - mean[None, :, :, None])
    f = torch.fft.rfft(centred, dim=-1, norm="ortho")
    covariance = torch.einsum("n,nohk,nogk->okhg", weight.to(f.dtype), f, f.conj())
    covariance = covariance.real  # mirrored maps cancel the imaginary part

    diagonal = covariance.diagonal(dim1=-2, dim2=-1).mean(-1)[..., None, None]
    covariance = covariance + SHRINK * diagonal * torch.eye(covariance.shape[-1])
    return mean.float(), covariance.float()


class GaussianPrior:
    """Codes ~ N(mean, C); the protocol is that of `prior.load`."""

    def __init__(self, mean: torch.Tensor, covariance: torch.Tensor, code: Code):
        """mean (3, h), covariance (3, h + 1, h, h): see `spectra`."""
        self.code = code
        self.height = mean.shape[1]
        self.width = 2 * self.height
        self.mean = mean[None, :, :, None]
        self.shares: dict[str, float] = {}  # there are no classes

        values, vectors = torch.linalg.eigh(covariance)
        self.values = values.clamp_min(1e-8)  # (3, h + 1, h)
        self.vectors = vectors  # (3, h + 1, h, h)

    @classmethod
    def from_tensors(cls, tensors: dict, facts: dict) -> GaussianPrior:
        """From what pipeline.prior.training.fit_gaussian wrote."""
        return cls(tensors["mean"], tensors["covariance"], Code(facts["mean"], facts["std"]))

    @property
    def log_spread(self) -> float:
        """Change of log radiance per unit of code."""
        return 2 * self.code.std

    @property
    def flat_mean(self) -> torch.Tensor:
        """Mean code (3, M)."""
        return self.mean.expand(1, 3, self.height, self.width).reshape(3, -1)

    def decode(self, x: torch.Tensor) -> torch.Tensor:
        """Codes (n, 3, h, w) -> scale-free radiance (n, 3, h, w)."""
        return self.code.decode(x)

    def encode(self, radiance: np.ndarray) -> torch.Tensor:
        """Scale-free radiance (h, w, 3) -> codes (1, 3, h, w)."""
        return self.code.encode(radiance)

    def filtered(
        self, x: torch.Tensor, gain: Callable[[torch.Tensor], torch.Tensor]
    ) -> torch.Tensor:
        """Multiply codes (n, 3, h, w) by gain(eigenvalues) in the covariance's eigenbasis."""
        f = torch.fft.rfft(torch.einsum("oc,nchw->nohw", OPPONENT, x), dim=-1, norm="ortho")
        vectors = self.vectors.to(f.dtype)
        inner = torch.einsum("okhe,nohk->noke", vectors, f) * gain(self.values)
        back = torch.einsum("okhe,noke->nohk", vectors, inner)
        opponent = torch.fft.irfft(back, n=x.shape[-1], dim=-1, norm="ortho")
        return torch.einsum("oc,nohw->nchw", OPPONENT, opponent)

    def denoise(
        self, x: torch.Tensor, sigma: float, label: str | Sequence[str | None] | None = None
    ) -> torch.Tensor:
        """E[x_0 | x_0 + sigma n = x] for codes (n, 3, h, w); there are no classes, `label` is not
        looked at.
        """
        return self.mean + self.filtered(x - self.mean, lambda v: v / (v + sigma**2))

    def sample(self, count: int, noise: torch.Generator) -> torch.Tensor:
        """Codes (count, 3, h, w)."""
        white = torch.randn((count, 3, self.height, self.width), generator=noise)
        return self.mean + self.filtered(white, torch.sqrt)

    def modes(self, count: int) -> tuple[torch.Tensor, torch.Tensor]:
        """B (count, 3, M) and variances (count,): leading eigenvectors of the covariance over all
        colours, times their deviation; codes ~ mean + sum of c_k B_k with c ~ N(0, 1), but for the
        variance left out. All 3 h w modes when `count` is larger.
        """
        h = self.height
        w = self.width
        found = []
        for k in range(w // 2 + 1):
            waves = [torch.cos] if k in (0, w // 2) else [torch.cos, torch.sin]
            found += [
                (float(self.values[o, k, e]), o, k, e, wave)
                for o in range(3)
                for e in range(h)
                for wave in waves
            ]
        found.sort(key=lambda item: -item[0])

        columns = torch.arange(w)
        B = torch.empty(min(count, len(found)), 3, h * w)
        for row, (value, o, k, e, wave) in zip(B, found):
            line = wave(2 * torch.pi * k * columns / w)
            mode = value**0.5 * torch.outer(self.vectors[o, k, :, e], line / line.norm())
            row[:] = OPPONENT[o][:, None] * mode.reshape(-1)
        return B, torch.tensor([item[0] for item in found[:count]])


def translated(code: torch.Tensor, gaussian: GaussianPrior, prior: Prior) -> torch.Tensor:
    """Codes (n, 3, h, w) of the Gaussian prior as codes (n, 3, f h, f w) of `prior`: the same
    radiance, every pixel f x f times. Raises ValueError where f is no whole number.
    """
    factor = prior.height // gaussian.height
    if factor * gaussian.height != prior.height:
        raise ValueError(f"{gaussian.height} rows do not divide {prior.height}")
    out = (code * gaussian.log_spread + gaussian.code.mean - prior.code.mean) / prior.log_spread
    return out.repeat_interleave(factor, 2).repeat_interleave(factor, 3)
