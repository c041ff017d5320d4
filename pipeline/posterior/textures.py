"""Between texture maps and values at texture coordinates: splat, gather, fill. Row 0 of a map is v
= 1.
"""

from __future__ import annotations

import cv2
import numpy as np
from scipy import ndimage


def splat(uv: np.ndarray, values: np.ndarray, size: int) -> np.ndarray:
    """Add values (n, c) bilinearly into a (size, size, c) texture, row 0 is v = 1."""
    x, y = uv[:, 0] * size - 0.5, (1 - uv[:, 1]) * size - 0.5
    out = np.zeros((size * size, values.shape[1]))
    for dx in (0, 1):
        for dy in (0, 1):
            i, j = np.floor(x).astype(int) + dx, np.floor(y).astype(int) + dy
            weight = (1 - np.abs(x - i)) * (1 - np.abs(y - j))
            flat = np.clip(j, 0, size - 1) * size + np.clip(i, 0, size - 1)
            for c in range(values.shape[1]):
                out[:, c] += np.bincount(flat, weight * values[:, c], size * size)
    return out.reshape(size, size, -1)


def gather(image: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """Bilinear values (n, c) of a texture (t, t, c), the adjoint of `splat`."""
    size = image.shape[0]
    x, y = (
        (uv[:, 0] * size - 0.5).astype(np.float32),
        ((1 - uv[:, 1]) * size - 0.5).astype(np.float32),
    )
    rows = -(-len(uv) // 16384)  # cv2.remap limits each side to 32767
    x, y = (np.pad(v, (0, rows * 16384 - len(uv))).reshape(rows, 16384) for v in (x, y))
    return cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE).reshape(
        rows * 16384, -1
    )[: len(uv)]


def fill(image: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Nearest known texel's value for unknown ones: chart borders and parts that no photo shows."""
    if not known.any():
        return image
    nearest = ndimage.distance_transform_edt(~known, return_distances=False, return_indices=True)
    return image[tuple(nearest)]
