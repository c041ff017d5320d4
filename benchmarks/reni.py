"""A RENI-like prior as a yardstick: a yaw-equivariant conditional neural field, trained as a
variational auto-decoder.

python -m benchmarks.reni --data RUN/data.npz --height 64 --minutes 10 --out reni.npz

After Gardner et al. 2022 (RENI), 2023 (RENI++), in this project's value code: a light is a matrix
of K latent vectors; radiance in direction d is an MLP of what no yaw changes, the products of the
latents' and d's horizontal parts, the latents' heights and norms, and d's height. Latents are
fitted per map with a Kullback-Leibler term towards N(0, I); samples decode draws of N(0, I). Writes
`codes`.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np
import torch
from torch import nn

from pipeline.base.errors import run_stage
from pipeline.base.files import atomic_path
from pipeline.prior.training.data import Data
from pipeline.render.envmap import directions, solid_angles

LATENTS = 36  # K
HIDDEN = 192
LAYERS = 5
PIXELS = 512  # per map and step
MAPS = 24  # per step
KL_WEIGHT = 1e-4  # RENI's own


class Field(nn.Module):
    """Code (n, p, 3) of latents (n, K, 3) in directions (n, p, 3)."""

    def __init__(self):
        super().__init__()
        sizes = [3 * LATENTS + 2] + LAYERS * [HIDDEN]
        self.layers = nn.ModuleList([nn.Linear(a, b) for a, b in zip(sizes, sizes[1:])])
        self.leave = nn.Linear(HIDDEN, 3)

    def forward(self, z, d):
        horizontal = z[..., [0, 2]]
        up = z[..., 1]
        along = d[..., [0, 2]]
        facing = torch.einsum("nki,npi->npk", horizontal, along)
        fixed = torch.cat([up, horizontal.norm(dim=-1)], -1)[:, None].expand(-1, d.shape[1], -1)
        x = torch.cat([facing, fixed, d[..., 1:2], along.norm(dim=-1, keepdim=True)], -1)

        first, second, *rest = self.layers
        x = torch.sin(30 / 2**4 * first(x))
        x = nn.functional.silu(second(x))
        for layer in rest:
            x = nn.functional.silu(layer(x)) + x
        return self.leave(x)


def fit(codes: np.ndarray, minutes: float, seed: int = 0) -> tuple[Field, torch.Tensor]:
    """Field and latent means (n, K, 3) after `minutes` of training on codes (n, 3, h, w)."""
    torch.manual_seed(seed)
    rng = np.random.default_rng(seed)
    n, _, h, w = codes.shape
    d = directions(h, w).reshape(-1, 3)
    weight = solid_angles(h, w).ravel()
    values = torch.from_numpy(codes.reshape(n, 3, -1).transpose(0, 2, 1).copy())

    field = Field()
    mean = nn.Parameter(0.1 * torch.randn(n, LATENTS, 3))
    log_deviation = nn.Parameter(torch.full((n, LATENTS, 3), -2.0))
    optimizer = torch.optim.Adam(
        [{"params": field.parameters(), "lr": 1e-3}, {"params": [mean, log_deviation], "lr": 1e-2}]
    )

    start = time.monotonic()
    while (spent := (time.monotonic() - start) / 60) < minutes:
        for group, rate in zip(optimizer.param_groups, (1e-3, 1e-2)):
            group["lr"] = rate * (1 - 0.97 * spent / minutes)
        maps = torch.from_numpy(rng.choice(n, min(MAPS, n), replace=False))
        pixels = torch.from_numpy(rng.choice(h * w, PIXELS, p=weight / weight.sum()))

        middle = mean[maps]
        spread = log_deviation[maps]
        z = middle + spread.exp() * torch.randn_like(middle)
        out = field(z, torch.from_numpy(d)[pixels].float()[None].expand(len(maps), -1, -1))
        kl = 0.5 * (middle**2 + (2 * spread).exp() - 2 * spread - 1).mean()
        loss = ((out - values[maps][:, pixels]) ** 2).mean() + KL_WEIGHT * kl * LATENTS

        optimizer.zero_grad(set_to_none=True)
        loss.backward()
        optimizer.step()

    print(
        f"loss {loss.item():.4f}, KL per number {kl.item():.3f}, "
        f"latent deviation {mean.std().item():.2f}"
    )
    return field, mean.detach()


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--height", type=int, default=64)
    parser.add_argument("--minutes", type=float, default=10)
    parser.add_argument("--count", type=int, default=128)
    parser.add_argument("--out", type=Path, required=True)
    args = parser.parse_args()
    torch.set_num_threads(1)
    field, _ = fit(Data.load(args.data, args.height).measured(False), args.minutes)
    with torch.no_grad():
        d = torch.from_numpy(directions(args.height, 2 * args.height).reshape(1, -1, 3)).float()
        codes = torch.cat([field(torch.randn(1, LATENTS, 3), d) for _ in range(args.count)])
    with atomic_path(args.out) as temporary, open(temporary, "wb") as file:
        np.savez(
            file, codes=codes.reshape(args.count, args.height, -1, 3).permute(0, 3, 1, 2).numpy()
        )


if __name__ == "__main__":
    run_stage(main)
