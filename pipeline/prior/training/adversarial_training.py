"""Training of the adversarial generator (prior/adversarial.py): the non-saturating loss (Goodfellow
et al. 2014) with R1, the critic's squared slope at true lights (Mescheder et al. 2018).
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy

import numpy as np
import torch
import torch.nn.functional as F
from torch import nn

from pipeline.base.progress import Bar
from pipeline.prior.adversarial import SLOPE, AdversarialGenerator
from pipeline.prior.network import Conv
from pipeline.prior.training.lights import Lights
from pipeline.prior.weight_facts import FIRST_ROWS

BATCH = 32
RATE = 2e-3  # of Adam, for both networks; falls to a tenth
BETAS = (0.0, 0.99)
R1_WEIGHT = 1.0
R1_EVERY = 8  # steps; its weight is as many times larger (Karras et al. 2020)
HALF_LIFE = 10_000  # images, of the generator's average


class Critic(nn.Module):
    """How true codes (n, 3, h, 2h) look, (n,). The sine of latitude is a channel; the last scale
    also sees how far the batch's maps are from each other (Karras et al. 2018).
    """

    def __init__(self, channels: Sequence[int]):
        super().__init__()
        self.enter = Conv(4, channels[-1])
        down = list(channels)[::-1]
        self.down = nn.ModuleList([Conv(a, b) for a, b in zip(down, down[1:])])
        self.last = Conv(channels[0] + 1, channels[0])
        self.leave = nn.Linear(channels[0] * FIRST_ROWS * 2 * FIRST_ROWS, 1)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        n, _, h, w = x.shape
        sine = torch.sin(np.pi * (0.5 - (torch.arange(h, device=x.device) + 0.5) / h))
        x = torch.cat([x, sine[None, None, :, None].expand(n, 1, h, w)], 1)
        x = F.leaky_relu(self.enter(x), SLOPE)
        for conv in self.down:
            x = F.leaky_relu(conv(F.avg_pool2d(x, 2)), SLOPE)
        apart = x.std(0).mean().expand(n, 1, *x.shape[2:])
        x = F.leaky_relu(self.last(torch.cat([x, apart], 1)), SLOPE)
        return self.leave(x.flatten(1))[:, 0]


def critic_loss(
    critic: Critic, true: torch.Tensor, made: torch.Tensor, slope: bool
) -> torch.Tensor:
    """slope: with R1."""
    true = true.requires_grad_(slope)
    said = critic(true)
    loss = F.softplus(-said).mean() + F.softplus(critic(made)).mean()
    if slope:
        (gradient,) = torch.autograd.grad(said.sum(), true, create_graph=True)
        r1 = 0.5 * R1_WEIGHT * gradient.square().sum((1, 2, 3)).mean()
        loss = loss + R1_EVERY * r1
    return loss


def train(
    generator: AdversarialGenerator, lights: Lights, steps: int, seed: int
) -> AdversarialGenerator:
    """The average of the generator's weights over `steps` steps of BATCH lights."""
    torch.manual_seed(seed)
    rng = np.random.default_rng(seed)
    device = lights.codes.device
    critic = Critic(generator.channels).to(device)
    networks = (generator, critic)
    makes, judges = (torch.optim.Adam(net.parameters(), RATE, betas=BETAS) for net in networks)
    average = deepcopy(generator)
    keep = 0.5 ** (BATCH / HALF_LIFE)

    with Bar("adversarial training", steps) as bar:
        for step in range(steps):
            for optimizer in (makes, judges):
                optimizer.param_groups[0]["lr"] = RATE * 0.1 ** (step / steps)
            latents = torch.randn(2, BATCH, *generator.latents, device=device)

            with torch.no_grad():
                made = generator(latents[0])
            judged = critic_loss(critic, lights.turned(BATCH, rng), made, step % R1_EVERY == 0)
            judges.zero_grad(set_to_none=True)
            judged.backward()
            judges.step()

            fooled = F.softplus(-critic(generator(latents[1]))).mean()
            makes.zero_grad(set_to_none=True)
            fooled.backward()
            makes.step()

            with torch.no_grad():
                for mean, now in zip(average.parameters(), generator.parameters()):
                    mean.lerp_(now, 1 - min(keep, step / (step + 10)))
            bar.step(f"critic {judged.item():.2f}, generator {fooled.item():.2f}")
    return average
