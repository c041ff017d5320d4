"""Camera rays of many pixels in one compiled loop: millions of them are traced for an asset."""

from __future__ import annotations

import numpy as np
from numba import njit

ONE = np.float32(1)


@njit(cache=True)
def rays_into(
    view: np.ndarray,
    pixel: np.ndarray,
    offset: np.ndarray,
    origin: np.ndarray,
    turn: np.ndarray,
    lens: np.ndarray,
    rays: np.ndarray,
) -> None:
    """Origins and unit directions, world frame, written to `rays` (2, n, 3), float32.

    view (n,): of each ray; pixel, offset (n, 2): column and row of the pixel's corner, and of the
    place in it. Of every view, float32: origin (v, 3), the camera's; turn (v, 3, 3), from the
    world's frame to the camera's (x right, y down, z ahead); lens (v, 4), fx, fy, cx, cy in pixels.
    """
    for i in range(len(view)):
        of_view, (fx, fy, cx, cy) = turn[view[i]], lens[view[i]]
        x = (np.float32(pixel[i, 0] + offset[i, 0]) - cx) / fx
        y = (np.float32(pixel[i, 1] + offset[i, 1]) - cy) / fy
        length = np.sqrt(x * x + y * y + ONE)
        for c in range(3):
            ahead = x * of_view[0, c] + y * of_view[1, c] + of_view[2, c]
            rays[0, i, c], rays[1, i, c] = origin[view[i], c], ahead / length
