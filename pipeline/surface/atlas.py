"""One UV atlas in [0, 1]^2 without overlaps (xatlas), or the mesh's own where it is valid."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numba import njit

from pipeline.base.config import Atlas
from pipeline.base.errors import InputError
from pipeline.base.images import write_png
from pipeline.geometry.mesh_io import Mesh, load_mesh, save_mesh, vertex_normals

# xatlas takes the resolution as a target and may exceed it: ask for less so that padding holds
ASK = 0.82


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


@njit(cache=False)
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
                    weight[row, column] = s, t
    return count, face, weight


def judge(uv: np.ndarray, faces: np.ndarray, size: int = 1024) -> dict:
    """utilisation: share of all texels that a triangle covers; overlap: share of these that two or
    more cover; in_range: whether all UVs lie in [0, 1].
    """
    count = rasterize(uv, faces, size)
    return {
        "utilisation": float((count > 0).mean()),
        "overlap": float((count > 1).sum() / max((count > 0).sum(), 1)),
        "in_range": bool(np.isfinite(uv).all() and uv.min() >= -1e-4 and uv.max() <= 1 + 1e-4),
    }


def unwrap(mesh: Mesh, settings: Atlas) -> tuple[Mesh, int]:
    """Charts by xatlas, packed into one square; vertices are split at seams. (Mesh with uv, number
    of charts).
    """
    import xatlas

    atlas = xatlas.Atlas()
    atlas.add_mesh(
        mesh.vertices.astype(np.float32),
        mesh.faces.astype(np.uint32),
        mesh.normals.astype(np.float32),
    )
    pack = xatlas.PackOptions()
    pack.resolution = max(16, int(ASK * settings.resolution))
    pack.padding = settings.padding
    pack.bilinear = True
    # xatlas turns a chart by swapping u and v, which mirrors it: a normal map's frame would turn
    # inside out there, differently in every renderer (pipeline/geometry/normal_maps.py)
    pack.rotate_charts = False
    charts = xatlas.ChartOptions()
    charts.fix_winding = True
    atlas.generate(charts, pack)
    if atlas.atlas_count != 1:
        raise InputError(
            f"the surface needs {atlas.atlas_count} atlas pages",
            "atlas",
            "raise atlas.resolution or lower mesh.faces or atlas.padding",
        )

    index, faces, uv = atlas[0]
    longest = max(atlas.width, atlas.height)
    uv = uv * [atlas.width / longest, atlas.height / longest]  # keep texels square
    uv = uv.astype(np.float64)
    unwrapped = Mesh(mesh.vertices[index], faces.astype(np.int64), mesh.normals[index], uv)
    return unwrapped, atlas.chart_count


def layout(uv: np.ndarray, faces: np.ndarray, size: int = 512) -> np.ndarray:
    """Picture of the charts (size, size, 3) uint8."""
    count = rasterize(uv, faces, size)
    colors = np.array([[24, 26, 30], [120, 170, 210], [230, 60, 60]], np.uint8)
    return colors[np.minimum(count, 2)]


def make_atlas(mesh_path: Path, out: Path, settings: Atlas) -> dict:
    """Write mesh_uv.ply, mesh_uv.obj and atlas.png into `out`; returns metrics."""
    mesh = load_mesh(mesh_path)
    own = judge(mesh.uv, mesh.faces) if mesh.uv is not None else None
    if own and own["in_range"] and own["overlap"] < 0.005:
        kept = mesh
        facts = own
        charts = None
        why = "the mesh's own UVs are a valid atlas"
    else:
        why = "the mesh has no UVs"
        if own:
            why = (
                f"the mesh's own UVs are not an atlas ({100 * own['overlap']:.1f} % overlap, "
                f"in [0, 1]: {own['in_range']})"
            )
            mesh = weld(mesh)
        kept, charts = unwrap(mesh, settings)
        assert kept.uv is not None
        facts = judge(kept.uv, kept.faces)

    if not facts["in_range"] or facts["overlap"] > 0.01:
        raise InputError(
            f"the atlas overlaps itself ({100 * facts['overlap']:.1f} % of its texels)",
            "atlas",
            "lower mesh.faces, or give a mesh with good UVs",
        )

    save_mesh(out / "mesh_uv.ply", kept)
    save_mesh(out / "mesh_uv.obj", kept)
    assert kept.uv is not None
    write_png(out / "atlas.png", layout(kept.uv, kept.faces))
    return {
        "charts": charts,
        "why": why,
        "faces": len(kept.faces),
        "vertices": len(kept.vertices),
    } | facts


def weld(mesh: Mesh) -> Mesh:
    """Undo splits at old seams so that they do not become chart borders."""
    vertices, index = np.unique(np.round(mesh.vertices, 7), axis=0, return_inverse=True)
    faces = index.reshape(-1)[mesh.faces]
    first, second, third = faces.T
    faces = faces[(first != second) & (second != third) & (third != first)]
    return Mesh(vertices, faces, vertex_normals(vertices, faces))
