"""Observed pixels as places on maps of one size: what many solves over the same pixels share."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from pipeline.posterior.pixel_loops import corners, gather_into, left_over_into, scatter_onto
from pipeline.posterior.textures import closed_gaps
from pipeline.render.observe import Observations


class MapPixels:
    """The n observed pixels, and the texels of maps (size, size, c) that they show."""

    def __init__(self, observations: Observations, size: int):
        self.observations = observations
        self.size = size
        self.texel, self.share = corners(observations.uv, size)
        # grazing views smear: their pixels cover many texels
        self.cosine: np.ndarray = observations.cosine[:, None].astype(np.float32)

    def of(self, image: np.ndarray) -> np.ndarray:
        """Bilinear values (n, c) of a map (size, size, c)."""
        out = np.empty((len(self.texel), image.shape[2]), np.float32)
        gather_into(flat(image), self.texel, self.share, out)
        return out

    def onto(self, values: np.ndarray) -> np.ndarray:
        """Sums (size, size, c) over each texel's pixels of values (n, c): `of`'s transpose."""
        out = np.zeros((self.size, self.size, values.shape[1]), np.float32)
        scatter_onto(self.texel, self.share, single(values), out.reshape(self.size**2, -1))
        return out

    def left_over(
        self,
        color: np.ndarray,
        scaled: np.ndarray,
        rest: np.ndarray,
        photo: np.ndarray,
        weight: np.ndarray,
    ) -> np.ndarray:
        """`onto` of what photos (n, 3) show beyond the picture that a map (size, size, 3) makes
        under a shading, D = scaled and S = rest (n, 3): weight (photo - (a D + S)).
        """
        left = self.of(color)
        shading = map(single, (scaled, rest, photo, weight))
        left_over_into(left.ravel(), *(values.ravel() for values in shading))
        return self.onto(left)

    @cached_property
    def count(self) -> np.ndarray:
        """How many pixels each texel has, (size, size, 1)."""
        return self.onto(np.ones_like(self.cosine))

    @cached_property
    def seen(self) -> np.ndarray:
        """Which texels are seen, (size, size): `textures.seen_texels`."""
        return closed_gaps(self.count[..., 0])


def single(values: np.ndarray) -> np.ndarray:
    """As the compiled loops take them: float32, one after the other."""
    return np.ascontiguousarray(values, np.float32)


def flat(image: np.ndarray) -> np.ndarray:
    """A map (t, t, c) as the loops take it, (t * t, c)."""
    return single(image).reshape(-1, image.shape[2])
