"""Means over a map's texels from few pixels: coarse to fine, over a pyramid of maps."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

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
        total = lambda image: np.add.reduce([image[i::2, j::2] for i in (0, 1) for j in (0, 1)])
        return TexelSums(total(self.color), total(self.shading), total(self.pixels))


def larger(image: np.ndarray, side: int) -> np.ndarray:
    """A map (t, t, 3) at the size (side, side, 3)."""
    return cv2.resize(image.astype(np.float32), (side, side)).reshape(side, side, 3)


def coarse_to_fine(sums: TexelSums, around: float) -> np.ndarray:
    """Colours (t, t, 3): every level's means, with the next coarser level's colour counted as
    `around` pixels. Where no pixel is, the coarser level's.
    """
    levels = [sums]
    while levels[-1].pixels.shape[0] % 2 == 0 and levels[-1].pixels.shape[0] > COARSEST:
        levels.append(levels[-1].halved())

    total = lambda image: image.sum((0, 1), keepdims=True)
    whole = TexelSums(*(total(image) for image in (sums.color, sums.shading, sums.pixels)))
    color = whole.color / np.maximum(whole.shading, 1e-9)
    shading = whole.shading / np.maximum(whole.pixels, 1e-9)  # of one pixel, around each texel
    for level in reversed(levels):
        side = level.pixels.shape[0]
        color = larger(color, side)
        shading = larger(shading, side)

        weight = around * shading
        color = (level.color + weight * color) / np.maximum(level.shading + weight, 1e-9)
        shading = (level.shading + shading) / (level.pixels + 1)
    return color
