"""Between texture maps and values at texture coordinates: splat, gather, fill.

Row 0 of a map is v = 1. Texel centres lie at +0.5.
"""

from __future__ import annotations

import cv2
import numpy as np
from scipy import ndimage, sparse

from pipeline.posterior.pixel_loops import corners, scatter_onto

REMAP_SIDE = 16384  # cv2.remap takes no more than 32767 values a side


def texel_position(uv: np.ndarray, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Column and row (n,) of texture coordinates (n, 2) in a map of side `size`, 0 at the centre of
    the first texel.
    """
    return uv[:, 0] * size - 0.5, (1 - uv[:, 1]) * size - 0.5


def splat(uv: np.ndarray, values: np.ndarray, size: int) -> np.ndarray:
    """Add values (n, c) at uv (n, 2) bilinearly into a map (size, size, c)."""
    total = np.zeros((size * size, values.shape[1]))
    scatter_onto(*corners(uv, size), np.ascontiguousarray(values, np.float32), total)
    return total.reshape(size, size, -1)


def bilinear_matrix(uv: np.ndarray, size: int) -> sparse.csr_matrix:
    """(n, size^2) matrix that takes a map's texels in row-major order to bilinear values at uv
    (n, 2): `gather` as a matrix, `splat` its transpose.
    """
    x, y = texel_position(uv, size)
    places, weights = [], []
    for right, down in ((0, 0), (0, 1), (1, 0), (1, 1)):
        column = np.floor(x).astype(np.int32) + right
        row = np.floor(y).astype(np.int32) + down
        weights.append((1 - np.abs(x - column)) * (1 - np.abs(y - row)))
        places.append(np.clip(row, 0, size - 1) * size + np.clip(column, 0, size - 1))

    four = np.arange(0, 4 * len(x) + 1, 4)
    parts = (np.stack(weights, 1).ravel().astype(np.float32), np.stack(places, 1).ravel(), four)
    return sparse.csr_matrix(parts, (len(x), size * size))


def gather(image: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """Bilinear values (n, c) of a map (t, t, c) at uv (n, 2), the adjoint of `splat`."""
    count = len(uv)
    rows = -(-count // REMAP_SIDE)  # rounded up
    padding = (0, rows * REMAP_SIDE - count)
    x, y = (
        np.pad(position.astype(np.float32), padding).reshape(rows, REMAP_SIDE)
        for position in texel_position(uv, image.shape[0])
    )

    values = cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return values.reshape(rows * REMAP_SIDE, -1)[:count]


def fill(image: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Nearest known texel's value for unknown ones: chart borders and parts that no photo shows.
    Without any known texel, the image as it is.
    """
    if not known.any():
        return image
    nearest = ndimage.distance_transform_edt(~known, return_distances=False, return_indices=True)
    return image[tuple(nearest)]


def seen_texels(uv: np.ndarray, size: int) -> np.ndarray:
    """Texels (size, size) that a pixel of texture coordinates uv (n, 2) falls next to, and gaps of
    a texel between those; padding between charts stays unseen.
    """
    return closed_gaps(splat(uv, np.ones((len(uv), 1)), size)[..., 0])


def closed_gaps(count: np.ndarray) -> np.ndarray:
    """`seen_texels` from how many pixels fall next to each texel, (size, size)."""
    seen = (count > 1e-3).astype(np.uint8)
    return cv2.morphologyEx(seen, cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8)).astype(bool)
