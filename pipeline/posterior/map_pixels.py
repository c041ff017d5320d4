"""Observed pixels as places on maps of one size: what many solves over the same pixels share."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from pipeline.posterior.textures import bilinear_matrix, closed_gaps
from pipeline.render.observe import Observations


class MapPixels:
    """The n observed pixels, and the texels of maps (size, size, c) that they show: `at_pixels`
    (n, size^2) takes a map's texels to the pixels, `at_texels` is its transpose.
    """

    def __init__(self, observations: Observations, size: int):
        self.observations = observations
        self.size = size
        self.at_pixels = bilinear_matrix(observations.uv, size)
        self.at_texels = self.at_pixels.T.tocsr()
        # grazing views smear: their pixels cover many texels
        self.cosine: np.ndarray = observations.cosine[:, None].astype(np.float32)

    def of(self, image: np.ndarray) -> np.ndarray:
        """Bilinear values (n, c) of a map (size, size, c)."""
        return self.at_pixels @ image.reshape(self.size**2, -1)

    def onto(self, values: np.ndarray) -> np.ndarray:
        """Sums (size, size, c) over each texel's pixels of values (n, c)."""
        return (self.at_texels @ values).reshape(self.size, self.size, -1)

    @cached_property
    def count(self) -> np.ndarray:
        """How many pixels each texel has, (size, size, 1)."""
        return self.onto(np.ones_like(self.cosine))

    @cached_property
    def seen(self) -> np.ndarray:
        """Which texels are seen, (size, size): `textures.seen_texels`."""
        return closed_gaps(self.count[..., 0])
