"""A dense voxel grid seen by many views: soft visual hull and its silhouettes.

Arrays: log-odds images (h, w) > 0 for object, < 0 for background, 0 for don't know; grid values
(nx, ny, nz).
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from pipeline.geometry.cameras import View

ROW = 16384  # points that one row of a look-up holds
OUTSIDE = -1e6  # pixel coordinate of points that are not in the frame


@dataclass
class Grid:
    """Axis-aligned grid of cubic cells; `low` is the outer corner, `shape` the number of cells."""

    low: np.ndarray
    cell: float
    shape: tuple[int, int, int]

    @classmethod
    def over(cls, low: np.ndarray, high: np.ndarray, longest: int) -> Grid:
        """The box from `low` to `high` (3,) with `longest` cells along its longest side."""
        cell = float((high - low).max() / longest)
        shape = tuple(int(np.ceil(side / cell - 1e-9)) for side in high - low)
        return cls(np.asarray(low, float), cell, shape)

    def centers(self) -> np.ndarray:
        """(n, 3) cell centres in C order."""
        axes = [self.low[i] + (np.arange(self.shape[i]) + 0.5) * self.cell for i in range(3)]
        return np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)


def sample(
    view: View, image: np.ndarray, points: np.ndarray, interpolate: bool = False
) -> tuple[np.ndarray, np.ndarray]:
    """Values (n,) or (n, channels) of `image` (any scale of the view) where points (n, 3) project,
    and which points lie inside the frame (n,).
    """
    uv, depth = view.project(points)
    h, w = image.shape[:2]
    x = uv[:, 0] * w / view.width - 0.5
    y = uv[:, 1] * h / view.height - 0.5
    inside = (depth > 0) & (x >= -0.5) & (y >= -0.5) & (x <= w - 0.5) & (y <= h - 0.5)

    # as a picture of rows: cv2.remap limits each side to 32767
    rows = int(np.ceil(len(points) / ROW))
    maps = np.full((2, rows * ROW), OUTSIDE, np.float32)
    maps[0, : len(points)] = np.where(inside, x, OUTSIDE)
    maps[1, : len(points)] = np.where(inside, y, OUTSIDE)
    mode = cv2.INTER_LINEAR if interpolate else cv2.INTER_NEAREST
    values = cv2.remap(image, *maps.reshape(2, rows, ROW), mode, borderMode=cv2.BORDER_REPLICATE)

    values = values.reshape(rows * ROW, *image.shape[2:])
    return values[: len(points)], inside


def silhouette(view: View, points: np.ndarray, cell: float, size: tuple[int, int]) -> np.ndarray:
    """Filled picture (h, w) bool of cubes of side `cell` around `points`; `size` = (width,
    height).
    """
    w, h = size
    uv, depth = view.project(points)
    x = (uv[:, 0] * w / view.width).astype(int)
    y = (uv[:, 1] * h / view.height).astype(int)
    inside = (depth > 0) & (x >= 0) & (y >= 0) & (x < w) & (y < h)

    out = np.zeros((h, w), np.uint8)
    if not inside.any():
        return out.astype(bool)
    out[y[inside], x[inside]] = 1

    # a cube's picture is a disc; gaps between the discs are closed
    radius = int(np.ceil(0.75 * cell * view.fx * w / view.width / np.median(depth[inside])))
    wide = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1,) * 2)
    narrow = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (max(radius, 1),) * 2)
    closed = cv2.morphologyEx(out, cv2.MORPH_CLOSE, wide, borderValue=0).astype(bool)
    return closed | cv2.dilate(out, narrow).astype(bool)
