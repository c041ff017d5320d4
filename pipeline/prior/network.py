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

SIGMA_DATA = 0.5
LABELS = ("indoor", "outdoor", "studio", "night")  # index len(LABELS) stands for "no label"
KINDS = len(LABELS) + 1  # a map that is made, not measured, adds KINDS to its index


class Conv(nn.Conv2d):
    """3x3 convolution, circular in longitude, replicated in latitude."""

    def __init__(self, a: int, b: int):
        super().__init__(a, b, 3)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return super().forward(
            F.pad(F.pad(x, (1, 1, 0, 0), mode="circular"), (0, 0, 1, 1), mode="replicate")
        )


class Block(nn.Module):
    """Residual block: norm, SiLU, conv, twice, with scale and shift from the noise embedding
    between.
    """

    def __init__(self, a: int, b: int, embedding: int):
        super().__init__()
        self.norm1, self.conv1 = nn.GroupNorm(8, a), Conv(a, b)
        self.affine = nn.Linear(embedding, 2 * b)
        self.norm2, self.conv2 = nn.GroupNorm(8, b), Conv(b, b)
        self.skip = nn.Conv2d(a, b, 1) if a != b else nn.Identity()
        nn.init.zeros_(self.conv2.weight)

    def forward(self, x: torch.Tensor, e: torch.Tensor) -> torch.Tensor:
        h = self.conv1(F.silu(self.norm1(x)))
        scale, shift = self.affine(e)[:, :, None, None].chunk(2, 1)
        h = self.conv2(F.silu(self.norm2(h) * (1 + scale) + shift))
        return self.skip(x) + h


class Attention(nn.Module):
    """Self-attention over all positions."""

    def __init__(self, c: int, heads: int = 4):
        super().__init__()
        self.heads, self.norm = heads, nn.GroupNorm(8, c)
        self.qkv, self.out = nn.Conv2d(c, 3 * c, 1), nn.Conv2d(c, c, 1)
        nn.init.zeros_(self.out.weight)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        n, c, h, w = x.shape
        q, k, v = (
            self.qkv(self.norm(x))
            .reshape(n, 3, self.heads, c // self.heads, h * w)
            .transpose(-1, -2)
            .unbind(1)
        )
        y = F.scaled_dot_product_attention(q, k, v).transpose(-1, -2).reshape(n, c, h, w)
        return x + self.out(y)


class UNet(nn.Module):
    """F(x; c_noise, label) on (n, 3, h, w); `channels` per level, each level half the size of the
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
    ):
        super().__init__()
        self.embedding = embedding
        self.embed = nn.Sequential(
            nn.Linear(embedding, embedding), nn.SiLU(), nn.Linear(embedding, embedding)
        )
        self.label = nn.Embedding(sources * KINDS, embedding)
        self.enter = Conv(4, channels[0])
        self.down, self.up, c, skips = nn.ModuleList(), nn.ModuleList(), channels[0], []
        for level, (width, count) in enumerate(zip(channels, blocks)):
            for _ in range(count):
                self.down.append(Block(c, width, embedding))
                c = width
                skips.append((level, c))
        self.middle = nn.ModuleList([Block(c, c, embedding), Attention(c), Block(c, c, embedding)])
        for level, width in reversed(skips):
            self.up.append(Block(c + width, width, embedding))
            c = width
        self.levels = [level for level, _ in skips]
        self.leave = nn.Sequential(nn.GroupNorm(8, c), nn.SiLU(), Conv(c, 3))

    def forward(self, x: torch.Tensor, noise: torch.Tensor, label: torch.Tensor) -> torch.Tensor:
        n, _, h, w = x.shape
        frequency = torch.exp(
            torch.linspace(0, math.log(1000), self.embedding // 2, device=x.device)
        )
        phase = noise[:, None] * frequency
        e = F.silu(self.embed(torch.cat([phase.sin(), phase.cos()], 1)) + self.label(label))
        sine = torch.sin(math.pi * (0.5 - (torch.arange(h, device=x.device) + 0.5) / h))
        x = self.enter(torch.cat([x, sine[None, None, :, None].expand(n, 1, h, w)], 1))
        kept, at = [], 0
        for block, level in zip(self.down, self.levels):
            if level != at:
                x, at = F.avg_pool2d(x, 2), level
            x = block(x, e)
            kept.append(x)
        x = self.middle[2](self.middle[1](self.middle[0](x, e)), e)
        for block, level in zip(self.up, reversed(self.levels)):
            if level != at:
                x, at = F.interpolate(x, scale_factor=2, mode="nearest"), level
            x = block(torch.cat([x, kept.pop()], 1), e)
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
        c_skip, c_out, c_in = SIGMA_DATA**2 / root**2, s * SIGMA_DATA / root, 1 / root
        return c_skip * x + c_out * self.net(c_in * x, sigma.reshape(-1).log() / 4, label)
