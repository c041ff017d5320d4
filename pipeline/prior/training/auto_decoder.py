"""Training of the equivariant field (prior/equivariant.py) as a variational auto-decoder: every map
has a normal distribution of latents of its own, with a Kullback-Leibler term towards N(0, I).
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import torch
from torch import nn

from pipeline.prior.equivariant import EquivariantField
from pipeline.render.envmap import directions, solid_angles

PIXELS = 512  # per map and step
MAPS = 24  # per step
KL_WEIGHT = 1e-4  # RENI's own
RATES = (1e-3, 1e-2)  # of Adam, for the field and the latents


def fit(
    field: EquivariantField, codes: torch.Tensor, spent: Iterable[float], seed: int = 0
) -> torch.Tensor:
    """Train the field on codes (n, 3, h, 2h); latent means (n, K, 3). A step for each number that
    `spent` gives: the share of the training that is over, on which the rates depend.
    """
    torch.manual_seed(seed)
    rng = np.random.default_rng(seed)
    n, _, h, w = codes.shape
    device = codes.device
    d = torch.from_numpy(directions(h, w)).float().reshape(-1, 3).to(device)
    weight = solid_angles(h, w).ravel()
    values = codes.reshape(n, 3, -1).transpose(1, 2).contiguous()

    mean = nn.Parameter(0.1 * torch.randn(n, *field.latents, device=device))
    log_deviation = nn.Parameter(torch.full((n, *field.latents), -2.0, device=device))
    parts = [field.parameters(), [mean, log_deviation]]
    optimizer = torch.optim.Adam([{"params": p, "lr": r} for p, r in zip(parts, RATES)])

    for share in spent:
        for group, rate in zip(optimizer.param_groups, RATES):
            group["lr"] = rate * (1 - 0.97 * share)
        maps = torch.from_numpy(rng.choice(n, min(MAPS, n), replace=False)).to(device)
        pixels = torch.from_numpy(rng.choice(h * w, PIXELS, p=weight / weight.sum())).to(device)

        middle = mean[maps]
        spread = log_deviation[maps]
        z = middle + spread.exp() * torch.randn_like(middle)
        out = field(z, d[pixels][None].expand(len(maps), -1, -1))
        kl = 0.5 * (middle**2 + (2 * spread).exp() - 2 * spread - 1).mean()
        count = field.latents[0]
        loss = ((out - values[maps][:, pixels]) ** 2).mean() + KL_WEIGHT * kl * count

        optimizer.zero_grad(set_to_none=True)
        loss.backward()
        optimizer.step()

    print(
        f"loss {loss.item():.4f}, KL per number {kl.item():.3f}, "
        f"latent deviation {mean.std().item():.2f}"
    )
    return mean.detach()
