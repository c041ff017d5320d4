"""Noise taken out of a surface's normals, the more the less its photos know of it.

A surface made from photos lies right on average and trembles: its normals, on which all shading
hangs, have more noise than its place. Where photos know much the tremble is shape, where they know
little it is noise.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse

from pipeline.geometry.mesh_io import Mesh, unit, vertex_adjacency

SPREAD = np.radians(20)  # angle at which a neighbour counts 60 %: noise averages out, edges stay
# On surfaces whose truth is known, fewer steps leave noise that is wider than a triangle, more take
# shape; where photos know nothing, more than the most gain little.
LEAST, MOST = 8, 32


def steps_of(known: np.ndarray) -> np.ndarray:
    """How many steps (n,) of the filter each vertex needs.

    known: (n,), how much photos know of where it lies (`pipeline.surface.photometric.Refined`). The
    noise of a place is as wide as 1 / sqrt(known); LEAST steps are for 1 and above.
    """
    wide = LEAST / np.sqrt(np.maximum(known, (LEAST / MOST) ** 2))
    return np.clip(np.rint(wide), LEAST, MOST).astype(int)


def filtered_normals(mesh: Mesh, steps: np.ndarray) -> np.ndarray:
    """Vertex normals (n, 3) averaged `steps` (n,) times over their neighbours, which count by how
    alike their normals are: bilateral normal filtering (Zheng et al. 2011), of vertices.
    """
    one_end, other_end = vertex_adjacency(len(mesh.vertices), mesh.faces).nonzero()

    normal = unit(mesh.normals)
    for step in range(int(steps.max(initial=0))):
        cosine = (normal[one_end] * normal[other_end]).sum(1)
        alike = np.exp(-0.5 * (np.arccos(np.clip(cosine, -1, 1)) / SPREAD) ** 2)
        links = sparse.csr_matrix((alike, (one_end, other_end)), (len(normal),) * 2)
        going_on = (step < steps)[:, None]
        normal = np.where(going_on, unit(normal + links @ normal), normal)
    return normal
