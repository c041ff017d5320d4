"""What fit, sample and refine share: observations, the renderer, the data term.

Data term, per channel, for radiance L and photo y: ((L - y) / (y + SHADE))^2, a relative error with
a floor, so that highlights do not outweigh the rest (design note `method.md` section 5). A
saturated observation is a lower bound: no penalty for being brighter.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pipeline.base.runtime import mitsuba_rays
from pipeline.render.observe import Observations
from pipeline.render.renderer import Explanation, Gradient, LossAndSlope, Renderer
from pipeline.render.shading_normals import shading_normals

SHADE = 0.1  # radiance (photo white = 1) below which errors count absolutely
ALBEDO_MAX = 0.98  # a brighter base colour would never come to rest in multi-bounce light


@dataclass
class PixelBatch:
    """Pixels of one optimisation step.

    index (n,) among the observations; origins, directions (spp, n, 3) of camera rays through them;
    observed (n, 3) linear radiance; clipped (n, 3) whether it is only a lower
    bound.
    """

    index: np.ndarray
    origins: np.ndarray
    directions: np.ndarray
    observed: np.ndarray
    clipped: np.ndarray


class Problem:
    """Draws batches of pixels and evaluates the data term with its gradient.

    roughness_min: least roughness that the light's grid can resolve. normal_error: median error of
    the mesh's normals in radians. normals: `shading_normals`, where they are known.
    """

    def __init__(
        self,
        observations: Observations,
        renderer: Renderer,
        roughness_min: float,
        normal_error: float = 0.0,
        normals: np.ndarray | None = None,
    ):
        self.observations = observations
        self.renderer = renderer
        self.roughness_min = roughness_min
        self.normal_error = normal_error
        self._normals = normals

    @property
    def shading_normals(self) -> np.ndarray:
        """Of all observed pixels (n, 3), in the world's frame, with the normal map."""
        if self._normals is None:
            rays = self.observations.centre_rays(np.arange(len(self.observations)))
            si = self.renderer.scene.ray_intersect(mitsuba_rays(*rays))
            self._normals = shading_normals(si, self.renderer.surface)
        return self._normals

    def with_pixels(self, index: np.ndarray) -> Problem:
        """The problem with the observed pixels `index` only; the renderer is shared."""
        some = self.observations.with_pixels(index)
        normals = self.shading_normals[index]
        return Problem(some, self.renderer, self.roughness_min, self.normal_error, normals)

    def at_texture(self, side: int) -> Problem:
        """The problem rendered with maps of another side; the observations are shared."""
        if side == self.renderer.texture:
            return self
        renderer = self.renderer.at_texture(side)
        normals = self.shading_normals
        return Problem(self.observations, renderer, self.roughness_min, self.normal_error, normals)

    def batch(
        self, pixels: int, spp: int, rng: np.random.Generator, view: int | None = None
    ) -> PixelBatch:
        """`pixels` random pixels with `spp` rays each, of all views or of one."""
        observations = self.observations
        if view is None:
            index = rng.integers(len(observations), size=pixels)
        else:
            index = rng.choice(np.flatnonzero(observations.view == view), pixels)
        index = np.sort(index)  # neighbours' rays follow each other (`by_place`)

        origins, directions = observations.rays(np.broadcast_to(index, (spp, pixels)), rng)
        return PixelBatch(
            index, origins, directions, observations.rgb[index], observations.clipped[index]
        )

    @staticmethod
    def residual(radiance: np.ndarray, batch: PixelBatch) -> np.ndarray:
        """Relative error with a floor (n, 3); zero where a saturated value is exceeded."""
        relative = (radiance - batch.observed) / (batch.observed + SHADE)
        return without_excess(relative, batch)

    def relative_loss(self, batch: PixelBatch) -> LossAndSlope:
        """The data term over a batch: a function radiance (n, 3) -> mean squared residual, and its
        derivative (n, 3) in the radiance.
        """

        def loss_and_slope(radiance: np.ndarray) -> tuple[float, np.ndarray]:
            residual = self.residual(radiance, batch)
            slope = 2 * residual / (batch.observed + SHADE) / residual.size
            return float((residual**2).mean()), slope

        return loss_and_slope

    def gradient(
        self,
        explanation: Explanation,
        batch: PixelBatch,
        seed: int,
        loss_and_slope: LossAndSlope | None = None,
    ) -> Gradient:
        """Of the data term, or of another `loss_and_slope(radiance) -> (loss, slope)`, in light and
        materials. `seed` fixes the renderer's paths.
        """
        return self.renderer.gradient(
            explanation,
            batch.origins,
            batch.directions,
            len(batch.observed),
            loss_and_slope or self.relative_loss(batch),
            seed,
        )


def without_excess(error: np.ndarray, batch: PixelBatch) -> np.ndarray:
    """Error (n, 3) of a prediction less the photo; zero where a saturated value is exceeded, for
    that is what saturation allows.
    """
    return np.where(batch.clipped & (error > 0), 0, error)


def renderer_seed(rng: np.random.Generator) -> int:
    """A fresh 31-bit seed for the renderer's paths; every step takes one of its own."""
    return int(rng.integers(1 << 31))
