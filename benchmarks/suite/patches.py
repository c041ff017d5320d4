"""Meshes of parametric patches, each in a tile of its own of one texture atlas.

A patch is a smooth map of the unit square into space, so that the texture's every texel has a
point on the surface: solid textures are evaluated there, without seams. Frame: Z-up, v up.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pipeline.geometry.mesh_io import Mesh, vertex_normals

Surface = Callable[[np.ndarray, np.ndarray], np.ndarray]  # u, v (n,) -> points (n, 3)
MARGIN = 0.04  # of a tile, on each side, is left to padding
WELD = 1e5  # vertices that agree to 1 / WELD are one point of the surface


@dataclass
class Patch:
    """surface: its u and v directions, in this order, turn counter-clockwise seen from outside;
    cells: quads along u and v; part: which of the object's materials it has.
    """

    surface: Surface
    cells: tuple[int, int]
    part: int = 0


def tiles(count: int) -> int:
    """Tiles along a side of the atlas of `count` patches."""
    return int(np.ceil(np.sqrt(count)))


def tile_corner(index: int, side: int) -> np.ndarray:
    """Corner (2,) of least u and v of a tile in the atlas of side x side tiles."""
    return np.array([index % side, index // side]) / side


def _grid(patch: Patch) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Parameters u, v (n,) of a patch's vertices and its triangles (m, 3)."""
    columns, rows = patch.cells
    u, v = np.meshgrid(np.linspace(0, 1, columns + 1), np.linspace(0, 1, rows + 1))

    index = np.arange(u.size).reshape(rows + 1, columns + 1)
    a, b = index[:-1, :-1].ravel(), index[:-1, 1:].ravel()
    c, d = index[1:, 1:].ravel(), index[1:, :-1].ravel()
    return u.ravel(), v.ravel(), np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])


def welded(vertices: np.ndarray) -> np.ndarray:
    """Index (n,) of the point of the surface that each vertex (n, 3) is."""
    return np.unique(np.round(vertices * WELD), axis=0, return_inverse=True)[1].reshape(-1)


def assembled(patches: list[Patch]) -> Mesh:
    """One mesh with an atlas; normals are those of the welded surface. Triangles that a pole makes
    a point are left out.
    """
    side = tiles(len(patches))
    vertices, faces, uv = [], [], []
    start = 0
    for k, patch in enumerate(patches):
        u, v, triangles = _grid(patch)
        vertices.append(patch.surface(u, v))
        inside = MARGIN + (1 - 2 * MARGIN) * np.stack([u, v], -1)
        uv.append(tile_corner(k, side) + inside / side)
        faces.append(triangles + start)
        start += len(u)

    points = np.concatenate(vertices)
    point = welded(points)
    triangles = np.concatenate(faces)
    first, second, third = point[triangles].T
    triangles = triangles[(first != second) & (second != third) & (third != first)]

    one_of_each = np.zeros((point.max() + 1, 3))
    one_of_each[point] = points
    normals = vertex_normals(one_of_each, point[triangles])
    return Mesh(points, triangles, normals[point], np.concatenate(uv))


def texel_points(patch: Patch, size: int) -> np.ndarray:
    """Points (size, size, 3) of the texels of a patch's tile, row 0 at v = 1; those in the margin
    take the nearest point of the patch.
    """
    centre = (np.arange(size) + 0.5) / size
    along = np.clip((centre - MARGIN) / (1 - 2 * MARGIN), 0, 1)
    u, v = np.meshgrid(along, along[::-1])
    return patch.surface(u.ravel(), v.ravel()).reshape(size, size, 3)


def in_pieces(patch: Patch, count: int) -> list[Patch]:
    """The patch cut into `count` along u."""
    columns, rows = patch.cells

    def piece(k: int) -> Patch:
        surface = lambda u, v: patch.surface((u + k) / count, v)
        return Patch(surface, (max(1, columns // count), rows), patch.part)

    return [piece(k) for k in range(count)]


def revolved(profile: np.ndarray, cells: tuple[int, int], part: int = 0) -> Patch:
    """Surface of revolution about the z axis of a smooth curve through control points (k, 2) of
    radius and height, from the axis below to the axis above, the outside on its right.
    """
    from scipy.interpolate import PchipInterpolator

    length = np.linalg.norm(np.diff(profile, axis=0), axis=1)
    curve = PchipInterpolator(np.concatenate([[0], np.cumsum(length)]) / length.sum(), profile)

    def surface(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        radius, height = curve(v).T
        radius = np.where((v <= 0) | (v >= 1), 0, radius)
        return np.stack([radius * np.cos(turn(u)), radius * np.sin(turn(u)), height], -1)

    return Patch(surface, cells, part)


def turn(u: np.ndarray) -> np.ndarray:
    """Angle of a whole turn's share u; exactly 0 at both ends, so that seams close."""
    return 2 * np.pi * (u % 1)


def ellipsoid(
    centre: tuple[float, float, float],
    radii: tuple[float, float, float],
    axis: tuple[float, float, float] = (0, 0, 1),
    part: int = 0,
    cells: tuple[int, int] = (32, 20),
) -> Patch:
    """An ellipsoid whose third radius lies along `axis`."""
    along = np.array(axis, float) / np.linalg.norm(axis)
    helper = np.eye(3)[np.abs(along).argmin()]
    across = np.cross(helper, along)
    across /= np.linalg.norm(across)
    frame = np.stack([across, np.cross(along, across), along])

    def surface(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        ring = np.where((v <= 0) | (v >= 1), 0, np.sin(np.pi * v))
        unit = np.stack([ring * np.cos(turn(u)), ring * np.sin(turn(u)), -np.cos(np.pi * v)], -1)
        return centre + (unit * radii) @ frame

    return Patch(surface, cells, part)


def cube_faces(cells: int, part: int = 0) -> list[Patch]:
    """The six sides of the cube [-1, 1]^3."""

    def side(axis: int, sign: float) -> Patch:
        def surface(u: np.ndarray, v: np.ndarray) -> np.ndarray:
            out = np.empty((len(u), 3))
            out[:, axis] = sign
            out[:, (axis + 1) % 3] = (2 * u - 1) * sign
            out[:, (axis + 2) % 3] = 2 * v - 1
            return out

        return Patch(surface, (cells, cells), part)

    return [side(axis, sign) for axis in range(3) for sign in (-1.0, 1.0)]


def mapped(patches: list[Patch], change: Callable[[np.ndarray], np.ndarray]) -> list[Patch]:
    """The patches with their points (n, 3) moved by `change`, which keeps what is outside."""
    moved = lambda surface: lambda u, v: change(surface(u, v))
    return [Patch(moved(patch.surface), patch.cells, patch.part) for patch in patches]


def even_sphere(points: np.ndarray) -> np.ndarray:
    """Points (n, 3) of the cube's surface on the unit sphere, with cells of nearly one size."""
    bent = np.tan(points * np.pi / 4)
    return bent / np.linalg.norm(bent, axis=1, keepdims=True)


def rounded_box(half: tuple[float, float, float], radius: float, cells: int, part: int = 0):
    """Six patches of a box with rounded edges about the origin."""
    core = np.array(half) - radius

    def change(points: np.ndarray) -> np.ndarray:
        full = points * half
        nearest = np.clip(full, -core, core)
        away = full - nearest
        return nearest + radius * away / np.linalg.norm(away, axis=1, keepdims=True)

    return mapped(cube_faces(cells, part), change)
