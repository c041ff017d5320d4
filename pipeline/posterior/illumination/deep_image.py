"""A light that an untrained convolutional network draws, under Adam: deep image prior (Ulyanov et
al. 2018).
"""

from __future__ import annotations

import numpy as np
import torch
import torch.nn.functional as F
from torch import nn

from pipeline.posterior.material_optimizer import BETAS
from pipeline.prior.network import Conv
from pipeline.render.envmap import mean_radiance

CHANNELS = 32
SKIPPED = 4  # channels that pass by the coarser scales
SCALES = 3  # halvings; the authors take five for pictures of 512 pixels
INPUT = 0.1  # the input is uniform in 0 to INPUT
SLOPE = 0.2  # of the leaky ReLU


class Hourglass(nn.Module):
    """(1, CHANNELS, h, w) -> (1, 3, h, w); h divides by 2^SCALES. Down and up again, with a thin
    skip at each scale; convolutions wrap around in longitude.

    Published: batch normalisation. Ours: group normalisation, the same for a batch of one and
    groups of one channel.
    """

    def __init__(self) -> None:
        super().__init__()
        self.down = nn.ModuleList([Conv(CHANNELS, CHANNELS) for _ in range(SCALES)])
        self.skip = nn.ModuleList([nn.Conv2d(CHANNELS, SKIPPED, 1) for _ in range(SCALES)])
        self.up = nn.ModuleList([Conv(CHANNELS + SKIPPED, CHANNELS) for _ in range(SCALES)])
        self.out = nn.Conv2d(CHANNELS, 3, 1)

    @staticmethod
    def _active(x: torch.Tensor) -> torch.Tensor:
        return F.leaky_relu(F.group_norm(x, x.shape[1]), SLOPE)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        passed = []
        for down, skip in zip(self.down, self.skip):
            passed.append(self._active(skip(x)))
            x = F.avg_pool2d(self._active(down(x)), 2)

        for up, beside in zip(reversed(self.up), reversed(passed)):
            x = F.interpolate(x, scale_factor=2, mode="nearest")
            x = self._active(up(torch.cat([x, beside], 1)))
        return self.out(x)


def initialise(network: nn.Module, noise: torch.Generator) -> None:
    """He et al. 2015 for every weight, zero for every bias, from `noise` alone."""
    for name, value in network.named_parameters():
        with torch.no_grad():
            if name.endswith("bias"):
                value.zero_()
            else:
                nn.init.kaiming_normal_(value, SLOPE, generator=noise)


class NetworkLight:
    """level * exp(f(z)), with z fixed noise and f the network whose weights move.

    Published: min over weights of E(f(z)) with the result of f in 0 to 1. Ours: the network draws
    log radiance, and begins at a constant light of the mean radiance `level` (its last layer begins
    at 0).
    """

    def __init__(self, light: np.ndarray, learning_rate: float, noise: torch.Generator):
        self.level = float(mean_radiance(light).mean())
        with torch.random.fork_rng(devices=[]):  # layers draw first weights, which are not used
            self.network = Hourglass()
        initialise(self.network, noise)
        nn.init.zeros_(self.network.out.weight)
        self.z = INPUT * torch.rand((1, CHANNELS, *light.shape[:2]), generator=noise)
        self.adam = torch.optim.Adam(self.network.parameters(), learning_rate, betas=BETAS)

    def _log(self) -> torch.Tensor:
        """log(radiance / level), (h, 2h, 3)."""
        return self.network(self.z)[0].permute(1, 2, 0)

    def light(self) -> np.ndarray:
        """Radiance (h, 2h, 3)."""
        with torch.no_grad():
            return self.level * torch.exp(self._log()).contiguous().numpy()

    def step(self, slope: np.ndarray, light: np.ndarray) -> None:
        """One step of Adam, for the loss's `slope` in the radiance at `light`."""
        self.adam.zero_grad()
        self._log().backward(torch.from_numpy(np.asarray(slope * light, np.float32)))
        self.adam.step()

    def set_learning_rate(self, learning_rate: float) -> None:
        self.adam.param_groups[0]["lr"] = learning_rate
