"""A dense voxel grid seen by many views: soft visual hull and its silhouettes.

Arrays: log-odds images (h, w) > 0 for object, < 0 for background, 0 for don't know; grid values
(nx, ny, nz).
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from pipeline.geometry.cameras import View


@dataclass
class Grid:
    """Axis-aligned grid of cubic cells; `low` is the outer corner, `shape` the number of cells."""

    low: np.ndarray
    cell: float
    shape: tuple[int, int, int]

    @classmethod
    def over(cls, low: np.ndarray, high: np.ndarray, longest: int) -> Grid:
        cell = float((high - low).max() / longest)
        return cls(
            np.asarray(low, float), cell, tuple(int(np.ceil(s / cell - 1e-9)) for s in high - low)
        )

    def centers(self) -> np.ndarray:
        """(n, 3) cell centres in C order."""
        axes = [self.low[i] + (np.arange(self.shape[i]) + 0.5) * self.cell for i in range(3)]
        return np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)


def sample(
    view: View, image: np.ndarray, points: np.ndarray, interpolate: bool = False
) -> tuple[np.ndarray, np.ndarray]:
    """Values of `image` (any scale of the view) where points (n, 3) project, and which points lie
    inside the frame.
    """
    uv, depth = view.project(points)
    h, w = image.shape[:2]
    x, y = uv[:, 0] * w / view.width - 0.5, uv[:, 1] * h / view.height - 0.5
    inside = (depth > 0) & (x >= -0.5) & (y >= -0.5) & (x <= w - 0.5) & (y <= h - 0.5)
    mode = cv2.INTER_LINEAR if interpolate else cv2.INTER_NEAREST
    rows = int(np.ceil(len(points) / 16384))  # cv2.remap limits each side to 32767
    padded = np.full((2, rows * 16384), -1e6, np.float32)
    padded[0, : len(points)], padded[1, : len(points)] = (
        np.where(inside, x, -1e6),
        np.where(inside, y, -1e6),
    )
    values = cv2.remap(
        image, *padded.reshape(2, rows, 16384), mode, borderMode=cv2.BORDER_REPLICATE
    )
    return values.reshape(rows * 16384, -1)[: len(points)].squeeze(
        -1
    ) if image.ndim == 2 else values.reshape(rows * 16384, image.shape[2])[: len(points)], inside


def silhouette(view: View, points: np.ndarray, cell: float, size: tuple[int, int]) -> np.ndarray:
    """Filled picture (h, w) bool of cubes of side `cell` around `points`; `size` = (width,
    height).
    """
    w, h = size
    uv, depth = view.project(points)
    x, y = (uv[:, 0] * w / view.width).astype(int), (uv[:, 1] * h / view.height).astype(int)
    ok = (depth > 0) & (x >= 0) & (y >= 0) & (x < w) & (y < h)
    out = np.zeros((h, w), np.uint8)
    if not ok.any():
        return out.astype(bool)
    out[y[ok], x[ok]] = 1
    radius = int(np.ceil(0.75 * cell * view.fx * w / view.width / np.median(depth[ok])))
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1,) * 2)
    return cv2.morphologyEx(out, cv2.MORPH_CLOSE, kernel, borderValue=0).astype(bool) | cv2.dilate(
        out, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (max(radius, 1),) * 2)
    ).astype(bool)
