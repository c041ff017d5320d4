"""How many triangles of an atlas cover each texel."""

from __future__ import annotations

import numpy as np
from numba import njit


def rasterize(uv: np.ndarray, faces: np.ndarray, size: int) -> np.ndarray:
    """How many triangles cover each texel centre, (size, size) int32; row 0 is v = 1.

    uv: (n, 2), v up; faces: (m, 3).
    """
    corners = (uv * [1, -1] + [0, 1])[faces] * size
    return _count(np.ascontiguousarray(corners), size)


@njit(cache=False)
def _count(corners: np.ndarray, size: int) -> np.ndarray:
    """The loop of `rasterize`: corners (m, 3, 2) in texels, x right and y down. Letters: a, b, c a
    triangle's corners; s, t barycentric coordinates of b and c.
    """
    count = np.zeros((size, size), np.int32)
    for k in range(len(corners)):
        a, b, c = corners[k]
        area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        if abs(area) < 1e-12:
            continue

        left = max(int(np.floor(min(a[0], b[0], c[0]))), 0)
        right = min(int(np.ceil(max(a[0], b[0], c[0]))), size)
        top = max(int(np.floor(min(a[1], b[1], c[1]))), 0)
        bottom = min(int(np.ceil(max(a[1], b[1], c[1]))), size)
        for row in range(top, bottom):
            for column in range(left, right):
                x = column + 0.5
                y = row + 0.5
                s = ((x - a[0]) * (c[1] - a[1]) - (y - a[1]) * (c[0] - a[0])) / area
                t = ((b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0])) / area
                if s > 1e-6 and t > 1e-6 and s + t < 1 - 1e-6:
                    count[row, column] += 1
    return count
