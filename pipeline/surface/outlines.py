"""How the edges of masks pull at the outlines of a surface.

The energy is half the squared distance, in pixels, between the rim of the surface's picture and the
edge of the mask, summed over the rim's pixels of all views. Its unit is that of photometric
refinement, whose energy is summed over pixels too, so that both may act at once.

Letters: x vertices; g, h first and second derivative of the energy by a vertex's movement along its
normal.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from functools import partial

import cv2
import numpy as np

from pipeline.geometry.cameras import View
from pipeline.surface.field import signed_distance
from pipeline.surface.zbuffer import Crop, z_buffer

FAR = 4.0  # pixels: a mask's edge that is farther away belongs to something else


def edge_of(mask: np.ndarray | None, shape: tuple[int, ...]) -> np.ndarray | None:
    """Signed distance to the edge of a mask (bool, any size), on a picture of that shape (h, w)."""
    if mask is None:
        return None
    h, w = shape
    size = cv2.resize(mask.astype(np.float32), (w, h), interpolation=cv2.INTER_AREA)
    return signed_distance(size > 0.5)


def outline_pull(
    x: np.ndarray,
    faces: np.ndarray,
    views: list[View],
    edges: list[np.ndarray | None],
    pool: ThreadPoolExecutor,
) -> np.ndarray:
    """g and h (2, n) of all views. edges: (h, w) signed distance of each view's mask, positive
    inside, None where it has no say.
    """
    asked = [(view, edge) for view, edge in zip(views, edges) if edge is not None]
    pulls = pool.map(partial(_pull, x, faces), *zip(*asked)) if asked else ()
    return sum(pulls, np.zeros((2, len(x))))


def _pull(x: np.ndarray, faces: np.ndarray, view: View, edge: np.ndarray) -> np.ndarray:
    """g and h (2, n) of one view.

    A vertex at the rim moves across the ray, so that the rim moves by as much on the picture. Each
    pixel's pull is shared alike by the corners of the triangle that it shows.
    """
    crop = Crop.around(view, x, 1)
    depth, shown = z_buffer(crop, x, faces)
    at = rim(shown >= 0)
    apart = crop.of(edge)[at]
    apart = np.where(apart > 0, apart - 1, apart)  # a mask's outermost pixels have a distance of 1
    near = np.abs(apart) <= FAR
    corners = faces[shown[at][near]].ravel()
    scale = view.fx / depth[at][near]
    share = lambda each: np.bincount(corners, np.repeat(each / 3, 3), len(x))
    return np.stack([share(apart[near] * scale), share(scale**2)])


def rim(covered: np.ndarray) -> np.ndarray:
    """Covered pixels (h, w) beside one that is not; none at the border, where the frame ends."""
    out = np.zeros_like(covered)
    inner = covered[1:-1, 1:-1]
    around = covered[:-2, 1:-1] & covered[2:, 1:-1] & covered[1:-1, :-2] & covered[1:-1, 2:]
    out[1:-1, 1:-1] = inner & ~around
    return out
