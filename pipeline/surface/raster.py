"""Which triangles of an atlas cover each texel."""

from __future__ import annotations

import numpy as np
from numba import njit

from pipeline.geometry.mesh_io import Mesh


def rasterize(uv: np.ndarray, faces: np.ndarray, size: int) -> np.ndarray:
    """How many triangles cover each texel centre, (size, size) int32; row 0 is v = 1.

    uv: (n, 2), v up; faces: (m, 3).
    """
    return _cover(_corners(uv, faces, size), size)[0]


def texel_faces(mesh: Mesh, size: int) -> tuple[np.ndarray, np.ndarray]:
    """The face that covers each texel centre (size, size), -1 where there is none, and the
    barycentric coordinates of its three corners there (size, size, 3); row 0 is v = 1.
    """
    assert mesh.uv is not None
    _, face, weight = _cover(_corners(mesh.uv, mesh.faces, size), size)
    return face, np.concatenate([1 - weight.sum(-1, keepdims=True), weight], -1)


def _corners(uv: np.ndarray, faces: np.ndarray, size: int) -> np.ndarray:
    """Corners (m, 3, 2) in texels, x right and y down."""
    return np.ascontiguousarray((uv * [1, -1] + [0, 1])[faces] * size)


@njit(cache=True)
def _cover(corners: np.ndarray, size: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The loop of `rasterize` and `texel_faces`: how many triangles cover each texel centre, the
    last of them (-1: none), and the barycentric coordinates (s, t) of its corners b and c.

    corners: (m, 3, 2) in texels, x right and y down. Letters: a, b, c a triangle's corners.
    """
    count = np.zeros((size, size), np.int32)
    face = np.full((size, size), -1, np.int32)
    weight = np.zeros((size, size, 2))
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
                    face[row, column] = k
                    weight[row, column, 0] = s
                    weight[row, column, 1] = t
    return count, face, weight
