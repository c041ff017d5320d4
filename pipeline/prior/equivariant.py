"""A light as a neural field that turns with its latent vectors, after RENI (Gardner et al. 2022,
2023).

A light is a matrix of K latent vectors; the code in direction d is an MLP of what no yaw changes:
the products of the latents' and d's horizontal parts, the latents' heights and norms, and d's
height. Turning every latent vector about the vertical therefore turns the light.

Published: the MLP is conditioned by FiLM or attention. Ours: one residual MLP of all that is
invariant.
"""

from __future__ import annotations

import torch
from torch import nn

from pipeline.prior.value_code import Code
from pipeline.render.envmap import directions

FREQUENCY = 30 / 2**4  # of the first layer's sine; SIREN's 30 is for inputs that fill [-1, 1]


class EquivariantField(nn.Module):
    """Codes of latents (n, K, 3) in directions (n, p, 3): (n, p, 3)."""

    rows = 1

    def __init__(self, code: Code, count: int = 36, hidden: int = 192, layers: int = 5):
        super().__init__()
        self.code = code
        self.shape = {"count": count, "hidden": hidden, "layers": layers}
        self.latents: tuple[int, ...] = (count, 3)
        sizes = [3 * count + 2] + layers * [hidden]
        self.layers = nn.ModuleList([nn.Linear(a, b) for a, b in zip(sizes, sizes[1:])])
        self.leave = nn.Linear(hidden, 3)

    @classmethod
    def from_tensors(cls, tensors: dict, facts: dict) -> EquivariantField:
        """From what pipeline.prior.training.train_generator wrote."""
        made = cls(Code(facts["mean"], facts["std"]), **facts["shape"])
        made.load_state_dict(tensors)
        return made.eval().requires_grad_(False)

    def forward(self, z: torch.Tensor, d: torch.Tensor) -> torch.Tensor:
        horizontal = z[..., [0, 2]]
        up = z[..., 1]
        along = d[..., [0, 2]]
        facing = torch.einsum("nki,npi->npk", horizontal, along)
        fixed = torch.cat([up, horizontal.norm(dim=-1)], -1)[:, None].expand(-1, d.shape[1], -1)
        x = torch.cat([facing, fixed, d[..., 1:2], along.norm(dim=-1, keepdim=True)], -1)

        first, second, *rest = self.layers
        x = torch.sin(FREQUENCY * first(x))
        x = nn.functional.silu(second(x))
        for layer in rest:
            x = nn.functional.silu(layer(x)) + x
        return self.leave(x)

    def codes(self, z: torch.Tensor, height: int) -> torch.Tensor:
        """Codes (n, 3, height, 2 height) of latents (n, K, 3)."""
        d = torch.from_numpy(directions(height, 2 * height)).float().reshape(1, -1, 3)
        values = self(z, d.expand(len(z), -1, -1))
        return values.reshape(len(z), height, 2 * height, 3).permute(0, 3, 1, 2)
