"""Denoiser D(x; sigma) over lat-long codes: a compact U-Net in EDM preconditioning (Karras et al.
2022, Table 1).

Convolutions wrap around in longitude and repeat the last row at the poles, so the seam is no
special place; the sine of latitude is an input channel because up and down differ. Most channels
live at low resolution, attention at the lowest.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import torch
import torch.nn.functional as F
from torch import nn

from pipeline.prior.weight_facts import LABELS

SIGMA_DATA = 0.5
KINDS = len(LABELS) + 1  # a map that is made, not measured, adds KINDS to its index


class Conv(nn.Conv2d):
    """3x3 convolution, circular in longitude, replicated in latitude."""

    def __init__(self, channels_in: int, channels_out: int):
        super().__init__(channels_in, channels_out, 3)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        wrapped = F.pad(x, (1, 1, 0, 0), mode="circular")
        return super().forward(F.pad(wrapped, (0, 0, 1, 1), mode="replicate"))


class Block(nn.Module):
    """Residual block: norm, SiLU, conv, twice, with scale and shift from the noise embedding
    between. In training a share `dropout` of what the second convolution sees is 0.
    """

    def __init__(self, channels_in: int, channels_out: int, embedding: int, dropout: float):
        super().__init__()
        self.dropout = dropout
        self.norm1 = nn.GroupNorm(8, channels_in)
        self.conv1 = Conv(channels_in, channels_out)
        self.affine = nn.Linear(embedding, 2 * channels_out)
        self.norm2 = nn.GroupNorm(8, channels_out)
        self.conv2 = Conv(channels_out, channels_out)
        self.skip: nn.Module = nn.Identity()
        if channels_in != channels_out:
            self.skip = nn.Conv2d(channels_in, channels_out, 1)
        nn.init.zeros_(self.conv2.weight)

    def forward(self, x: torch.Tensor, embedded: torch.Tensor) -> torch.Tensor:
        inner = self.conv1(F.silu(self.norm1(x)))
        scale, shift = self.affine(embedded)[:, :, None, None].chunk(2, 1)
        inner = F.silu(self.norm2(inner) * (1 + scale) + shift)
        inner = self.conv2(F.dropout(inner, self.dropout, self.training))
        return self.skip(x) + inner


class Attention(nn.Module):
    """Self-attention over all positions."""

    def __init__(self, channels: int, heads: int = 4):
        super().__init__()
        self.heads = heads
        self.norm = nn.GroupNorm(8, channels)
        self.qkv = nn.Conv2d(channels, 3 * channels, 1)
        self.out = nn.Conv2d(channels, channels, 1)
        nn.init.zeros_(self.out.weight)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        n, c, h, w = x.shape
        split = self.qkv(self.norm(x)).reshape(n, 3, self.heads, c // self.heads, h * w)
        query, key, value = split.transpose(-1, -2).unbind(1)
        seen = F.scaled_dot_product_attention(query, key, value)
        return x + self.out(seen.transpose(-1, -2).reshape(n, c, h, w))


class UNet(nn.Module):
    """F(x; c_noise, label) on (n, 3, h, w); `channels` per scale, each scale half the size of the
    one before.

    With sources = 2 the label also says whether a map was measured or made (procedural, or expanded
    from LDR): the made ones teach the shape of scenes, and samples are drawn as measured ones.
    """

    def __init__(
        self,
        channels: Sequence[int] = (24, 48, 96),
        blocks: Sequence[int] = (1, 2, 2),
        embedding: int = 96,
        sources: int = 1,
        dropout: float = 0.0,
    ):
        super().__init__()
        self.embedding = embedding
        self.embed = nn.Sequential(
            nn.Linear(embedding, embedding), nn.SiLU(), nn.Linear(embedding, embedding)
        )
        self.label = nn.Embedding(sources * KINDS, embedding)
        self.enter = Conv(4, channels[0])
        self.down = nn.ModuleList()
        self.up = nn.ModuleList()

        now = channels[0]
        skips = []
        for scale, (width, count) in enumerate(zip(channels, blocks)):
            for _ in range(count):
                self.down.append(Block(now, width, embedding, dropout))
                now = width
                skips.append((scale, width))

        self.middle = nn.ModuleList(
            [
                Block(now, now, embedding, dropout),
                Attention(now),
                Block(now, now, embedding, dropout),
            ]
        )
        for _, width in reversed(skips):
            self.up.append(Block(now + width, width, embedding, dropout))
            now = width
        self.scales = [scale for scale, _ in skips]
        self.leave = nn.Sequential(nn.GroupNorm(8, now), nn.SiLU(), Conv(now, 3))

    def _embedded(self, noise: torch.Tensor, label: torch.Tensor) -> torch.Tensor:
        """Fourier features of the noise level and the class, (n, embedding)."""
        half = self.embedding // 2
        frequency = torch.exp(torch.linspace(0, math.log(1000), half, device=noise.device))
        phase = noise[:, None] * frequency
        waves = torch.cat([phase.sin(), phase.cos()], 1)
        return F.silu(self.embed(waves) + self.label(label))

    def forward(self, x: torch.Tensor, noise: torch.Tensor, label: torch.Tensor) -> torch.Tensor:
        n, _, h, w = x.shape
        embedded = self._embedded(noise, label)
        sine = torch.sin(math.pi * (0.5 - (torch.arange(h, device=x.device) + 0.5) / h))
        x = self.enter(torch.cat([x, sine[None, None, :, None].expand(n, 1, h, w)], 1))

        kept = []
        now = 0
        for block, scale in zip(self.down, self.scales):
            if scale != now:
                x = F.avg_pool2d(x, 2)
                now = scale
            x = block(x, embedded)
            kept.append(x)

        first, attention, second = self.middle
        x = second(attention(first(x, embedded)), embedded)

        for block, scale in zip(self.up, reversed(self.scales)):
            if scale != now:
                x = F.interpolate(x, scale_factor=2, mode="nearest")
                now = scale
            x = block(torch.cat([x, kept.pop()], 1), embedded)
        return self.leave(x)


class Denoiser(nn.Module):
    """D(x; sigma) = c_skip x + c_out F(c_in x; c_noise)."""

    def __init__(self, **options: Any):
        super().__init__()
        self.options = options
        self.net = UNet(**options)

    def forward(self, x: torch.Tensor, sigma: torch.Tensor, label: torch.Tensor) -> torch.Tensor:
        s = sigma.reshape(-1, 1, 1, 1)
        root = (s**2 + SIGMA_DATA**2).sqrt()
        c_skip = SIGMA_DATA**2 / root**2
        c_out = s * SIGMA_DATA / root
        c_in = 1 / root
        c_noise = sigma.reshape(-1).log() / 4
        return c_skip * x + c_out * self.net(c_in * x, c_noise, label)
