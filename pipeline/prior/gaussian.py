"""The Gaussian prior: natural light as a normal distribution of codes, stationary in yaw, symmetric
under mirroring.

Fourier transform over longitude makes the covariance block-diagonal: one (h, h) matrix per
frequency and opponent colour channel, estimated from the same maps as the diffusion prior.
Denoising is closed form, E[x | x + sigma n], which makes it the yardstick that samplers are held
against; its leading eigenvectors are a smooth basis for light.
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
    x, p = torch.from_numpy(codes).double(), torch.from_numpy(weights / weights.sum()).double()
    mean = torch.einsum("n,nchw->ch", p, x) / x.shape[-1]
    centred = torch.einsum("oc,nchw->nohw", OPPONENT.double(), x - mean[None, :, :, None])
    f = torch.fft.rfft(centred, dim=-1, norm="ortho")
    cov = torch.einsum(
        "n,nohk,nogk->okhg", p.to(f.dtype), f, f.conj()
    ).real  # mirrored maps cancel the imaginary part
    diagonal = cov.diagonal(dim1=-2, dim2=-1).mean(-1)
    return mean.float(), (
        cov + SHRINK * diagonal[..., None, None] * torch.eye(cov.shape[-1])
    ).float()


class GaussianPrior:
    """Codes ~ N(mean, C); see the package docstring for the protocol."""

    def __init__(self, mean: torch.Tensor, covariance: torch.Tensor, code: Code):
        self.code, self.height, self.width = code, mean.shape[1], 2 * mean.shape[1]
        self.mean = mean[None, :, :, None]
        self.values, self.vectors = torch.linalg.eigh(covariance)  # (3, k, h), (3, k, h, h)
        self.values = self.values.clamp_min(1e-8)
        self.shares: dict[str, float] = {}  # there are no classes

    @classmethod
    def from_tensors(cls, tensors: dict, facts: dict) -> GaussianPrior:
        return cls(tensors["mean"], tensors["covariance"], Code(facts["mean"], facts["std"]))

    @property
    def log_spread(self) -> float:
        return 2 * self.code.std

    @property
    def flat_mean(self) -> torch.Tensor:
        """Mean code (3, M)."""
        return self.mean.expand(1, 3, self.height, self.width).reshape(3, -1)

    def decode(self, x: torch.Tensor) -> torch.Tensor:
        return self.code.decode(x)

    def encode(self, radiance: np.ndarray) -> torch.Tensor:
        return self.code.encode(radiance)

    def filtered(
        self, x: torch.Tensor, gain: Callable[[torch.Tensor], torch.Tensor]
    ) -> torch.Tensor:
        """Multiply codes (n, 3, h, w) by gain(eigenvalues) in the covariance's eigenbasis."""
        f = torch.fft.rfft(torch.einsum("oc,nchw->nohw", OPPONENT, x), dim=-1, norm="ortho")
        inner = torch.einsum("okhe,nohk->noke", self.vectors.to(f.dtype), f) * gain(self.values)
        back = torch.einsum("okhe,noke->nohk", self.vectors.to(f.dtype), inner)
        return torch.einsum(
            "oc,nohw->nchw", OPPONENT, torch.fft.irfft(back, n=x.shape[-1], dim=-1, norm="ortho")
        )

    def denoise(
        self, x: torch.Tensor, sigma: float, label: str | Sequence[str | None] | None = None
    ) -> torch.Tensor:
        """E[x_0 | x_0 + sigma n = x] for codes (n, 3, h, w); there are no classes, `label` is not
        looked at.
        """
        return self.mean + self.filtered(x - self.mean, lambda v: v / (v + sigma**2))

    def sample(self, count: int, noise: torch.Generator) -> torch.Tensor:
        """Codes (count, 3, h, w)."""
        return self.mean + self.filtered(
            torch.randn((count, 3, self.height, self.width), generator=noise), torch.sqrt
        )

    def modes(self, count: int) -> tuple[torch.Tensor, torch.Tensor]:
        """B (count, 3, M) and variances (count,): leading eigenvectors of the covariance over all
        colours, times their deviation; codes ~ mean + sum of c_k B_k with c ~ N(0, 1), but for the
        variance left out. All 3 h w modes when `count` is larger.
        """
        h, w = self.height, self.width
        columns, found = torch.arange(w), []
        for k in range(w // 2 + 1):
            waves = [torch.cos] if k in (0, w // 2) else [torch.cos, torch.sin]
            found += [
                (float(self.values[o, k, e]), o, k, e, wave)
                for o in range(3)
                for e in range(h)
                for wave in waves
            ]
        found.sort(key=lambda item: -item[0])
        B = torch.empty(min(count, len(found)), 3, h * w)
        for row, (value, o, k, e, wave) in zip(B, found):
            line = wave(2 * torch.pi * k * columns / w)
            row[:] = OPPONENT[o][:, None] * (
                value**0.5 * torch.outer(self.vectors[o, k, :, e], line / line.norm())
            ).reshape(-1)
        return B, torch.tensor([item[0] for item in found[:count]])


def translated(code: torch.Tensor, gaussian: GaussianPrior, prior: Prior) -> torch.Tensor:
    """Codes (n, 3, h, w) of the Gaussian prior as codes (n, 3, f h, f w) of `prior`: the same
    radiance, every pixel f x f times.
    """
    f = prior.height // gaussian.height
    if f * gaussian.height != prior.height:
        raise ValueError(f"{gaussian.height} rows do not divide {prior.height}")
    log = (code * gaussian.log_spread + gaussian.code.mean - prior.code.mean) / prior.log_spread
    return log.repeat_interleave(f, 2).repeat_interleave(f, 3)
