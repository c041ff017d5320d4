"""A fused surface made anew: screened Poisson reconstruction.

Where depth maps hardly agree fusion leaves rags, for one wrong depth map tears what it looks
through. So the surface is made once more, as the smooth one that passes through its points along
their normals (Kazhdan and Hoppe 2013, by pymeshlab). A point counts as much as depth maps agree on
it, and fully where it lies on the hull, for which masks stand. Points that hardly a depth map
stands for are left out beside those that are known. Far from these they stay and count little: a
wide hole would be closed flat. Of its parts those are kept that are the object's (solids.py).

Points of another surface may stand in for those that did not earn their place (earned.py).
"""

from __future__ import annotations

import numpy as np
from scipy import ndimage, sparse
from scipy.spatial import cKDTree

from pipeline.geometry.mesh_io import Mesh, vertex_normals
from pipeline.geometry.voxels import Grid
from pipeline.surface.clean import volumes
from pipeline.surface.solids import Covered, of_the_object

# agreeing views, summed over depth maps, of a point that counts fully, and of one that is known; no
# more than so many for every depth map, where those are few
FULLY, FULLY_EACH = 60.0, 2.0
KNOWN, KNOWN_EACH = 8.0, 0.25
BRIDGED = 6.0  # cells from a known point, within which others are left out
ON_HULL = 0.15  # truncation distances from the hull, within which masks stand for a point
LEAST = 0.05  # what a point counts that is not known
ROOM = 1.1  # side of the cube that the surface is made in, of the surface's, at least
NEAR = 2.0  # cells between a part's vertices and points; a part farther away is a bubble
BESIDE = 3.0  # cells from a point that is used, within which no other stands in


def rebuilt(
    surface: Mesh,
    weight: np.ndarray,
    hull: np.ndarray,
    grid: Grid,
    maps: int,
    covered: Covered | None = None,
    earned: np.ndarray | None = None,
    instead: Mesh | None = None,
) -> tuple[Mesh, dict]:
    """The closed surface through points of `surface`, and facts: `left_out`, the share of points
    that it does without, and `parts`, how many of the parts that were made are the object's, and
    of how many. Where none is, it is the surface as it is, and the facts say so.

    weight: agreeing views, summed over `maps` depth maps; hull: positive inside, in truncation
    distances; both of the grid's shape. Of small parts none is the object's where nothing is known
    of masks (`covered`). earned: which points (n,) bool may be used, none: all; the vertices of
    `instead` stand in for others, fully.
    """
    at = (surface.vertices - grid.low) / grid.cell - 0.5
    sampled = lambda field: ndimage.map_coordinates(field, at.T, order=1, mode="nearest")
    agreeing, by_masks = sampled(weight), np.abs(sampled(hull)) < ON_HULL
    counts = np.clip(agreeing / min(FULLY, FULLY_EACH * maps), LEAST, 1)
    counts[by_masks] = 1
    known = by_masks | (agreeing >= min(KNOWN, KNOWN_EACH * maps))
    allowed = np.ones(len(surface.vertices), bool) if earned is None else earned
    known &= allowed
    used = allowed & (known | _far(surface.vertices, surface.vertices[known], BRIDGED * grid.cell))
    facts: dict = {"left_out": float(1 - used.mean())}

    points, normals, counts = surface.vertices[used], surface.normals[used], counts[used]
    if instead is not None:
        new = _far(instead.vertices, points, BESIDE * grid.cell)
        points = np.concatenate([points, instead.vertices[new]])
        normals = np.concatenate([normals, instead.normals[new]])
        counts = np.concatenate([counts, np.ones(int(new.sum()))])
    vertices, faces = _poisson(points, normals, counts, grid.cell)
    made, facts["parts"] = _of_the_object(vertices, faces, points, grid, covered)
    return (surface if made is None else made), facts


def _far(points: np.ndarray, others: np.ndarray, limit: float) -> np.ndarray:
    """Which points (n, 3) lie farther than `limit` from all others (k, 3)."""
    return cKDTree(others).query(points)[0] > limit if len(others) else np.ones(len(points), bool)


def _poisson(
    points: np.ndarray, normals: np.ndarray, counts: np.ndarray, cell: float
) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (n, 3) and faces (m, 3) through points (k, 3) with outward normals (k, 3) that count
    (k,), in an octree whose smallest cells have the side `cell`.
    """
    import pymeshlab

    across = max(float(np.ptp(points, axis=0).max()) / cell, 1.0)
    depth = int(np.ceil(np.log2(ROOM * across)))
    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(
        pymeshlab.Mesh(vertex_matrix=points, v_normals_matrix=normals, v_scalar_array=counts)
    )
    # one thread: the order of sums, and so the surface, would hang on more
    meshes.generate_surface_reconstruction_screened_poisson(
        depth=depth, scale=2**depth / across, confidence=True, threads=1
    )
    made = meshes.current_mesh()
    return made.vertex_matrix(), made.face_matrix().astype(np.int64)


def _of_the_object(
    vertices: np.ndarray,
    faces: np.ndarray,
    points: np.ndarray,
    grid: Grid,
    covered: Covered | None,
) -> tuple[Mesh | None, list[int]]:
    """The surface of those connected parts that are the object's, and of how many out of how many.
    A part whose vertices, in the median, do not lie near points is a bubble.
    """
    if not len(faces):
        return None, [0, 0]
    edges = np.concatenate([faces[:, :2], faces[:, 1:]])
    joined = sparse.coo_matrix((np.ones(len(edges)), edges.T), (len(vertices), len(vertices)))
    count, part = sparse.csgraph.connected_components(joined, directed=False)
    number = part[faces[:, 0]]
    away = cKDTree(points).query(vertices)[0]
    near = np.atleast_1d(ndimage.median(away, part, np.arange(count))) < NEAR * grid.cell
    cells = np.bincount(number, volumes(vertices, faces), count) / grid.cell**3
    mesh_of = lambda kept: _mesh(vertices, faces[kept[number]])
    kept = of_the_object(np.where(near, cells, 0.0), mesh_of, covered) & near
    return (mesh_of(kept) if kept.any() else None), [int(kept.sum()), count]


def _mesh(vertices: np.ndarray, faces: np.ndarray) -> Mesh:
    """The mesh of these faces (m, 3) and of no other vertices."""
    corners, numbers = np.unique(faces, return_inverse=True)
    vertices, faces = vertices[corners], numbers.reshape(-1, 3)
    return Mesh(vertices, faces, vertex_normals(vertices, faces))
