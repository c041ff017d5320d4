"""Means over a map's texels from few pixels: coarse to fine, over a pyramid of maps."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from pipeline.posterior.pixel_loops import blend_into

COARSEST = 32  # side of the pyramid's smallest map


@dataclass
class TexelSums:
    """Sums over the pixels of every texel of a map: of w (y - S) and of w D, both (t, t, 3); and
    how many pixels there are, (t, t, 1).
    """

    color: np.ndarray
    shading: np.ndarray
    pixels: np.ndarray

    def halved(self) -> TexelSums:
        """The map of half the side."""
        return TexelSums(*map(quarters, (self.color, self.shading, self.pixels)))


def quarters(image: np.ndarray) -> np.ndarray:
    """Sums of four texels each, (t / 2, t / 2, c), of a map (t, t, c)."""
    side = len(image) // 2
    mean = cv2.resize(image, (side, side), interpolation=cv2.INTER_AREA)
    return 4 * mean.reshape(side, side, -1)


def larger(image: np.ndarray, side: int) -> np.ndarray:
    """A map (t, t, 3) at the size (side, side, 3)."""
    return cv2.resize(image, (side, side)).reshape(side, side, 3)


def coarse_to_fine(sums: TexelSums, around: float) -> np.ndarray:
    """Colours (t, t, 3): every level's means, with the next coarser level's colour counted as
    `around` pixels. Where no pixel is, the coarser level's.
    """
    levels = [sums]
    while levels[-1].pixels.shape[0] % 2 == 0 and levels[-1].pixels.shape[0] > COARSEST:
        levels.append(levels[-1].halved())

    end, total = levels[-1], lambda image: image.sum((0, 1), keepdims=True)
    whole = TexelSums(*(total(image) for image in (end.color, end.shading, end.pixels)))
    color = whole.color / np.maximum(whole.shading, 1e-9)
    shading = whole.shading / np.maximum(whole.pixels, 1e-9)  # of one pixel, around each texel
    for level in reversed(levels):
        side = level.pixels.shape[0]
        color, shading = larger(color, side), larger(shading, side)
        blend_into(color, shading, level.color, level.shading, level.pixels, np.float32(around))
    return color
