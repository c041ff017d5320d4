"""A hull drawn taut: a thin plate between the rims along which masks touch the object.

A visual hull (Laurentini 1994) touches the object only along the rims that its views see. Between
them it stands off in flat facets, whose creases no photo asks for. Here its vertices move along
their normals until its outlines are the edges of the masks (`pipeline.surface.outlines`), with the
thin plate of `pipeline.surface.plate` between rims. As in photometric refinement each step solves

    (second derivatives of the outlines + thin plate) movement = gradient of both

for all vertices at once.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np

from pipeline.base.progress import Bar
from pipeline.geometry.cameras import View
from pipeline.geometry.mesh_io import Mesh, vertex_normals
from pipeline.surface.outlines import edge_of, outline_pull
from pipeline.surface.pictures import affordable, at_size, reduced
from pipeline.surface.plate import Plate, footprint_of

STEPS = 5
# Stiffer is smoother on what is round, and blows up what is thin.
STIFFNESS = 50.0
CREASE = 0.1  # bend in pixels' footprints from which on the plate gives way
PIXELS = 8e6  # of all masks' boxes together, at most, that one step looks at


def taut(mesh: Mesh, views: list[View], masks: list[np.ndarray], threads: int) -> Mesh:
    """The mesh with its outlines on the edges of the masks, and smooth between them.

    masks: (h, w) bool per view, of its whole picture. Faces and their order are kept.
    """
    shrink = affordable(mesh, views, masks, PIXELS)
    pictures = [reduced(mask, shrink) for mask in masks]
    sized = [at_size(view, picture) for view, picture in zip(views, pictures)]
    edges = [edge_of(mask, picture.shape) for mask, picture in zip(masks, pictures)]

    x = mesh.vertices.astype(float)
    faces = np.ascontiguousarray(mesh.faces)
    plate = Plate(len(x), faces, STIFFNESS, CREASE)
    with Bar("draw hull taut", STEPS) as bar, ThreadPoolExecutor(threads) as pool:
        for _ in range(STEPS):
            g, h = outline_pull(x, faces, sized, edges, pool)
            # at home wherever it is: nothing has to stay where the hull had it
            x, moved = plate.step(x, x, g, h, footprint_of(x, sized))
            bar.step(f"moved by {moved:.2f} pixels")
    return Mesh(x, mesh.faces, vertex_normals(x, mesh.faces), mesh.uv)
