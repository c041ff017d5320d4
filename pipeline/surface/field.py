"""Dense fields over a voxel grid from many views: visual hull and depth maps. Compiled with numba,
one thread per slab.

Sign: positive inside the object. Unit: the truncation distance; values clipped to [-1, 1]. Letters
of the compiled loops: i, j, k a cell; x, y, z its centre; v a view, m its (3, 4) matrix; d depth; u
column and r row of a pixel.
"""

from __future__ import annotations

import cv2
import numpy as np
from numba import njit, prange

from pipeline.geometry.cameras import View
from pipeline.geometry.voxels import Grid

MAX_IGNORED = 12  # views that the hull may leave out of account in one cell


def projections(views: list[View], width: int, height: int) -> np.ndarray:
    """(v, 3, 4) matrices from world points to pixel coordinates of images resized to (width,
    height).
    """
    resized = [v.at_size(width, height) for v in views]
    return np.stack([v.K @ v.world_to_camera[:3] for v in resized]).astype(np.float32)


def signed_distance(mask: np.ndarray) -> np.ndarray:
    """Pixels to the mask's edge, positive inside (h, w)."""
    inside = cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, 3)
    outside = cv2.distanceTransform(1 - mask.astype(np.uint8), cv2.DIST_L2, 3)
    return (inside - outside).astype(np.float32)


@njit(parallel=True, fastmath=True, cache=True)
def hull_field(
    low: np.ndarray,
    cell: np.float32,
    shape: tuple[int, int, int],
    matrices: np.ndarray,
    distances: np.ndarray,
    focal: np.ndarray,
    truncation: np.float32,
    tolerance: float,
) -> np.ndarray:
    """Per cell the smallest signed distance over the views that see it, but for the smallest few:
    as many are ignored as `tolerance` (a fraction) of those views.
    """
    out = np.empty(shape, np.float32)
    views, h, w = distances.shape
    most = min(int(tolerance * views), MAX_IGNORED)
    for i in prange(shape[0]):
        smallest = np.empty(most + 1, np.float32)
        for j in range(shape[1]):
            for k in range(shape[2]):
                x = low[0] + (i + 0.5) * cell
                y = low[1] + (j + 0.5) * cell
                z = low[2] + (k + 0.5) * cell
                smallest[:] = 1e9
                seen = 0
                outside = 0
                for v in range(views):
                    m = matrices[v]
                    d = m[2, 0] * x + m[2, 1] * y + m[2, 2] * z + m[2, 3]
                    if d <= 0:
                        continue
                    u = int((m[0, 0] * x + m[0, 1] * y + m[0, 2] * z + m[0, 3]) / d)
                    r = int((m[1, 0] * x + m[1, 1] * y + m[1, 2] * z + m[1, 3]) / d)
                    if u < 0 or r < 0 or u >= w or r >= h:
                        continue
                    seen += 1
                    value = distances[v, r, u] * d / focal[v]
                    if value <= -truncation:
                        outside += 1
                        if outside > most:  # -1, whatever the other views say
                            break
                    if value < smallest[most]:
                        p = most
                        while p > 0 and smallest[p - 1] > value:
                            smallest[p] = smallest[p - 1]
                            p -= 1
                        smallest[p] = value
                ignored = min(int(tolerance * seen), most)
                value = smallest[ignored] / truncation if seen * 2 >= views else -1.0
                if outside > most:
                    value = -1.0
                out[i, j, k] = min(max(value, -1.0), 1.0)
    return out


@njit(parallel=True, fastmath=True, cache=True)
def stereo_field(
    low: np.ndarray,
    cell: np.float32,
    shape: tuple[int, int, int],
    matrices: np.ndarray,
    depths: np.ndarray,
    weights: np.ndarray,
    truncation: np.float32,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Weighted mean of truncated (cell depth - surface depth), its weight, and votes for free
    space, per cell.
    """
    out = np.zeros(shape, np.float32)
    total = np.zeros(shape, np.float32)
    free = np.zeros(shape, np.float32)
    views, h, w = depths.shape
    for i in prange(shape[0]):
        for j in range(shape[1]):
            for k in range(shape[2]):
                x = low[0] + (i + 0.5) * cell
                y = low[1] + (j + 0.5) * cell
                z = low[2] + (k + 0.5) * cell
                for v in range(views):
                    m = matrices[v]
                    d = m[2, 0] * x + m[2, 1] * y + m[2, 2] * z + m[2, 3]
                    if d <= 0:
                        continue
                    u = int((m[0, 0] * x + m[0, 1] * y + m[0, 2] * z + m[0, 3]) / d)
                    r = int((m[1, 0] * x + m[1, 1] * y + m[1, 2] * z + m[1, 3]) / d)
                    if u < 0 or r < 0 or u >= w or r >= h or weights[v, r, u] == 0:
                        continue
                    behind = (d - depths[v, r, u]) / truncation
                    if behind < -1:
                        free[i, j, k] += 1
                    elif behind <= 1:
                        out[i, j, k] += behind * weights[v, r, u]
                        total[i, j, k] += weights[v, r, u]
                if total[i, j, k] > 0:
                    out[i, j, k] /= total[i, j, k]
    return out, total, free


def stacked(images: list[np.ndarray], interpolation: int = cv2.INTER_NEAREST) -> np.ndarray:
    """(v, h, w) float32: all images resized to the first one's size."""
    h, w = images[0].shape
    return np.stack(
        [
            i if i.shape == (h, w) else cv2.resize(i, (w, h), interpolation=interpolation)
            for i in images
        ]
    ).astype(np.float32)


def _at_most(mask: np.ndarray, side: int) -> np.ndarray:
    """A mask (h, w) bool with its longer side reduced to `side` pixels."""
    factor = min(1.0, side / max(mask.shape))
    mask = mask.astype(np.uint8)
    return cv2.resize(mask, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA) > 0


def hull_of(
    grid: Grid, views: list[View], masks: list[np.ndarray], truncation: float, tolerance: float
) -> np.ndarray:
    """Soft visual hull field (nx, ny, nz) of boolean masks."""
    distances = stacked([signed_distance(_at_most(m, 900)) for m in masks])
    h, w = distances.shape[1:]
    focal = np.array([v.fx * w / v.width for v in views], np.float32)
    return hull_field(
        grid.low.astype(np.float32),
        np.float32(grid.cell),
        grid.shape,
        projections(views, w, h),
        distances,
        focal,
        np.float32(truncation),
        tolerance,
    )
