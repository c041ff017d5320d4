"""What fit, sample and refine share: observations, the renderer, the data term, material steps.

Data term, per channel: ((L - y) / (y + SHADE))^2, a relative error with a floor, so that highlights
do not outweigh the rest (design note `method.md` section 5). A saturated observation is a lower
bound: no penalty for being brighter.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import torch

from pipeline.render.observe import Observations
from pipeline.render.renderer import Explanation, Gradient, Renderer

SHADE = 0.1  # radiance (photo white = 1) below which errors count absolutely
SMOOTH = 80  # roughness and metallic gradients are blurred by 1 / SMOOTH of the texture's side
ALBEDO_MAX = 0.98  # a brighter base colour would never come to rest in multi-bounce light


@dataclass
class Batch:
    """Pixels of one step: rays o, d (spp, n, 3), observed y (n, 3), clipped (n,)."""

    index: np.ndarray
    o: np.ndarray
    d: np.ndarray
    y: np.ndarray
    clipped: np.ndarray


class Problem:
    """Draws batches and evaluates the data term with its gradient. `normal_error`: median error of
    the mesh's normals in radians.
    """

    def __init__(
        self,
        observations: Observations,
        renderer: Renderer,
        roughness_min: float,
        normal_error: float = 0.0,
    ):
        self.observations, self.renderer, self.roughness_min, self.normal_error = (
            observations,
            renderer,
            roughness_min,
            normal_error,
        )

    def batch(
        self, pixels: int, spp: int, rng: np.random.Generator, view: int | None = None
    ) -> Batch:
        """Random pixels of all views, or of one."""
        obs = self.observations
        index = (
            rng.integers(len(obs), size=pixels)
            if view is None
            else rng.choice(np.flatnonzero(obs.view == view), pixels)
        )
        o, d = obs.rays(np.broadcast_to(index, (spp, pixels)), rng)
        return Batch(index, o, d, obs.rgb[index], obs.clipped[index])

    @staticmethod
    def residual(L: np.ndarray, batch: Batch) -> np.ndarray:
        """Weighted residual (n, 3); zero where a saturated pixel is exceeded."""
        r = (L - batch.y) / (batch.y + SHADE)
        return np.where(batch.clipped[:, None] & (r > 0), 0, r)

    def loss_and_slope(self, batch: Batch):
        """dloss for `Renderer.gradient`: mean squared weighted residual and its derivative in L."""

        def dloss(L):
            r = self.residual(L, batch)
            return float((r**2).mean()), 2 * r / (batch.y + SHADE) / r.size

        return dloss

    def gradient(self, x: Explanation, batch: Batch, seed: int, loss=None) -> Gradient:
        """Of the data term, or of another `loss(L) -> (value, slope in L)`."""
        return self.renderer.gradient(
            x, batch.o, batch.d, len(batch.y), loss or self.loss_and_slope(batch), seed
        )


class Materials:
    """Base colour, roughness, metallic as torch parameters under Adam, projected to their valid
    sets (Eqs. 15-17).
    """

    def __init__(
        self,
        x: Explanation,
        learning_rate,
        roughness_min: float,
        names=("base_color", "roughness", "metallic"),
    ):
        """learning_rate: one number, or one per name."""
        self.values = {
            n: torch.from_numpy(getattr(x, n).copy())
            for n in ("base_color", "roughness", "metallic")
        }
        self.bounds = {
            "base_color": (0.0, ALBEDO_MAX),
            "roughness": (roughness_min, 1.0),
            "metallic": (0.0, 1.0),
        }
        self.names = names
        rates = (
            learning_rate
            if isinstance(learning_rate, dict)
            else dict.fromkeys(names, learning_rate)
        )
        self.optimizer = torch.optim.Adam(
            [{"params": [self.values[n]], "lr": rates[n]} for n in names], betas=(0.9, 0.99)
        )

    def step(self, gradient: Gradient) -> None:
        for n in self.names:
            slope = np.ascontiguousarray(getattr(gradient, n), np.float32)
            if (
                n != "base_color"
            ):  # photos say little about their fine detail: move them as smooth fields
                slope = cv2.GaussianBlur(slope, (0, 0), max(slope.shape[0] / SMOOTH, 0.5))
            self.values[n].grad = torch.from_numpy(slope)
        self.optimizer.step()
        for n in self.names:
            self.values[n].clamp_(*self.bounds[n])

    def decay(self, learning_rate: float) -> None:
        for group in self.optimizer.param_groups:
            group["lr"] = learning_rate

    def explanation(self, light: np.ndarray) -> Explanation:
        return Explanation(
            light, *(self.values[n].numpy() for n in ("base_color", "roughness", "metallic"))
        )


def generators(settings, seed: int) -> tuple[np.random.Generator, torch.Generator]:
    """Random numbers of sample `seed`, its own and no other sample's."""
    return np.random.default_rng([settings.seed, seed]), torch.Generator().manual_seed(
        settings.seed * 100003 + seed
    )


def guided_result(
    prior, x: torch.Tensor, scale: float, materials: Materials, first: float, last: float
) -> tuple[Explanation, dict]:
    """Explanation and facts of a sampler that ends with the code x (1, 3, h, w)."""
    with torch.no_grad():
        light = scale * prior.decode(x)[0].numpy().transpose(1, 2, 0)
    return materials.explanation(np.ascontiguousarray(light)), {
        "scale": scale,
        "loss_first": first,
        "loss_last": last,
    }


def step_seed(rng: np.random.Generator) -> int:
    """A fresh 31-bit seed for the renderer."""
    return int(rng.integers(1 << 31))
