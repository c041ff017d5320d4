"""Colours of the surface that no photo shows: the smoothest ones that join on to those around.

They solve Laplace's equation over the mesh, with the seen corners' colours given (membrane
interpolation: Perez, Gangnet and Blake, Poisson Image Editing, 2003, equation 2). The nearest seen
colour instead makes stripes and patches, and of an atlas' charts the nearest is mostly another part
of the thing.
"""

from __future__ import annotations

import numpy as np
from scipy import ndimage, sparse
from scipy.sparse import csgraph
from scipy.sparse.linalg import splu

from pipeline.geometry.mesh_io import Mesh
from pipeline.posterior.textures import fill
from pipeline.surface.raster import texel_faces

LEAST_SHARE = 0.1  # texels that a corner needs the colour of, to be seen
# share of a map's texels that hang together, from which on a patch counts as seen: a few rays slip
# through cracks of a surface and by its rims, and a chart that no photo shows would take their
# colour. 50 texels of 1024 a side; a ray's pixel covers as much of the surface in a coarser map
LEAST_PATCH = 50 / 1024**2


def over_unseen(image: np.ndarray, shown: np.ndarray, mesh: Mesh) -> np.ndarray:
    """The map (t, t, c) with smooth colours on texels of the mesh's surface that are not `shown`
    (t, t) bool; beside the charts the nearest texel's. Without any shown patch, as it is.
    """
    face, weight = texel_faces(mesh, len(image))
    surface = face >= 0
    known = patches(surface & shown)
    if not known.any():
        return image

    points, corner = np.unique(mesh.vertices, axis=0, return_inverse=True)  # charts joined
    faces = corner.reshape(-1)[mesh.faces]
    color, seen = corner_colors(image, known, faces[face], weight, len(points))
    color = harmonic(color, seen, points, faces)

    out = image.copy()
    hidden = surface & ~shown
    out[hidden] = np.einsum("nk,nkc->nc", weight[hidden], color[faces[face[hidden]]])
    return fill(out, surface | shown)


def patches(shown: np.ndarray) -> np.ndarray:
    """Those of the texels (t, t) bool that hang together with LEAST_PATCH of the map or more, and
    with one other at least.
    """
    number, _ = ndimage.label(shown, np.ones((3, 3)))
    large = np.bincount(number.ravel()) >= max(LEAST_PATCH * shown.size, 2)
    large[0] = False  # what is not shown
    return large[number]


def corner_colors(
    image: np.ndarray, known: np.ndarray, corners: np.ndarray, weight: np.ndarray, count: int
) -> tuple[np.ndarray, np.ndarray]:
    """Mean colours (count, c) of the corners over `known` texels (t, t) of their triangles, and
    which corners have some. corners, weight (t, t, 3): each texel's and their barycentric weights.
    """
    at, share = corners[known].ravel(), weight[known].ravel()
    total = np.bincount(at, share, count)
    values = np.repeat(image[known], 3, 0) * share[:, None]
    sums = np.stack([np.bincount(at, channel, count) for channel in values.T], 1)
    return sums / np.maximum(total, 1e-9)[:, None], total > LEAST_SHARE


def harmonic(
    color: np.ndarray, known: np.ndarray, points: np.ndarray, faces: np.ndarray
) -> np.ndarray:
    """Colours (n, c) of which each that is not known is its neighbours' mean by inverse distance;
    of parts without any known corner, the mean of all known ones.

    points: (n, 3); faces: (m, 3).
    """
    edges = np.unique(np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), 1), axis=0)
    edges = edges[edges[:, 0] != edges[:, 1]]
    near = 1 / np.maximum(np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1), 1e-12)
    one_way = sparse.coo_matrix((near, edges.T), (len(points), len(points)))
    joined = (one_way + one_way.T).tocsr()

    _, part = csgraph.connected_components(joined)
    out = color.copy()
    apart = ~np.isin(part, part[known])
    out[apart] = color[known].mean(0)
    free = ~known & ~apart
    if free.any():
        laplacian = (sparse.diags(np.asarray(joined.sum(1)).ravel()) - joined).tocsr()[free]
        given = -(laplacian[:, ~free] @ out[~free])
        out[free] = splu(laplacian[:, free].tocsc()).solve(given)
    return out
