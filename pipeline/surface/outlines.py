"""A hull drawn taut: a thin plate between the rims along which masks touch the object.

A visual hull (Laurentini 1994) touches the object only along the rims that its views see. Between
them it stands off in flat facets, whose creases no photo asks for. Here its vertices move along
their normals until the outlines of the surface are those of the masks, with the thin plate of
`pipeline.surface.plate` between rims. As in photometric refinement each step solves

    (second derivatives of the outlines + thin plate) movement = gradient of both

for all vertices at once. The outlines' energy is half the squared distance in pixels between the
rim of the surface's picture and the mask's edge, summed over the rim's pixels.

Letters: x vertices; g, h first and second derivative of the outlines' energy by a vertex's movement
along its normal.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from functools import partial

import numpy as np

from pipeline.base.progress import Bar
from pipeline.geometry.cameras import View
from pipeline.geometry.mesh_io import Mesh, vertex_normals
from pipeline.surface.field import signed_distance
from pipeline.surface.photometric import affordable
from pipeline.surface.pictures import at_size, reduced
from pipeline.surface.plate import Plate, footprint_of
from pipeline.surface.zbuffer import Crop, z_buffer

STEPS = 5
# Stiffer is smoother on what is round, and blows up what is thin.
STIFFNESS = 50.0
CREASE = 0.1  # bend in pixels' footprints from which on the plate gives way
FAR = 4.0  # pixels: a mask's edge that is farther away belongs to something else
PIXELS = 8e6  # of all masks' boxes together, at most, that one step looks at


def taut(mesh: Mesh, views: list[View], masks: list[np.ndarray], threads: int) -> Mesh:
    """The mesh with its outlines on the edges of the masks, and smooth between them.

    masks: (h, w) bool per view, of its whole picture. Faces and their order are kept.
    """
    shrink = affordable(mesh, views, masks, PIXELS)
    sized = [reduced(mask, shrink) > 0.5 for mask in masks]
    views = [at_size(view, mask) for view, mask in zip(views, sized)]
    edges = [signed_distance(mask) for mask in sized]

    x = mesh.vertices.astype(float)
    faces = np.ascontiguousarray(mesh.faces)
    plate = Plate(len(x), faces, STIFFNESS, CREASE)
    with Bar("draw hull taut", STEPS) as bar, ThreadPoolExecutor(threads) as pool:
        for _ in range(STEPS):
            pulls = pool.map(partial(_pull, x, faces), views, edges)
            g, h = np.sum(list(pulls), axis=0)
            # at home wherever it is: nothing has to stay where the hull had it
            x, moved = plate.step(x, x, g, h, footprint_of(x, views))
            bar.step(f"moved by {moved:.2f} pixels")
    return Mesh(x, mesh.faces, vertex_normals(x, mesh.faces), mesh.uv)


def _pull(x: np.ndarray, faces: np.ndarray, view: View, edge: np.ndarray) -> np.ndarray:
    """g and h (2, n) of one view. edge (h, w): signed distance of its mask.

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
