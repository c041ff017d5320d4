"""What may be wrong with masks. Every function takes the masks (n, h, w) bool of a scene's photos,
how much is wrong, and a generator; it returns the spoilt ones, None for a mask that is missing. At
0 nothing changes.
"""

from __future__ import annotations

import numpy as np
from scipy import ndimage


def moved_edge(masks: np.ndarray, pixels: float, rng) -> list[np.ndarray]:
    """Outlines moved outward by `pixels`, inward where negative."""
    grow = lambda mask: ndimage.distance_transform_edt(~mask) <= pixels
    shrink = lambda mask: ndimage.distance_transform_edt(mask) > -pixels
    return [grow(mask) if pixels >= 0 else shrink(mask) for mask in masks]


def missing(masks: np.ndarray, share: float, rng) -> list[np.ndarray | None]:
    """Without this share of the masks."""
    lost = rng.permutation(len(masks))[: round(share * len(masks))]
    return [None if k in lost else mask for k, mask in enumerate(masks)]
