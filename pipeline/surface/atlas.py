"""One UV atlas in [0, 1]^2 without overlaps, or the mesh's own where it is valid."""

from __future__ import annotations

from importlib import metadata
from pathlib import Path

import numpy as np

from pipeline.base.config import Atlas
from pipeline.base.errors import InputError
from pipeline.base.images import write_png
from pipeline.geometry.mesh_io import Mesh, load_mesh, save_mesh, unit, vertex_normals
from pipeline.geometry.normal_maps import mirrored_share
from pipeline.surface.charts import (
    FlatChart,
    cut,
    cut_again,
    face_normals,
    flattened,
    triangle_areas,
)
from pipeline.surface.pack import packed
from pipeline.surface.pack_tight import tightly_packed
from pipeline.surface.plate import umbrella
from pipeline.surface.raster import rasterize

PACK_AT = 1024  # texels along a side at which charts are packed at most
PAGES = 4  # times that charts are packed at most, where some cover a texel twice
EVENING = 10  # times that vertices are moved towards their neighbours before charts are cut
MOVED = 0.01  # of the object's size: lumps of a mesh from photos are evened by less
DISTORTED = 1.0  # mean doublings of area between surface and page: evening has taken the shape
SHRUNK = 0.5  # of its true length a chart keeps at least: evening makes small loose parts vanish

PACKERS = {"xatlas": packed, "tight": tightly_packed}


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
    """Few flat charts, packed into one square; vertices are split at seams, faces keep their
    order. (Mesh with uv, number of charts). Raises InputError where the charts do not fit.

    Charts are cut and laid flat on an evened copy of the surface, so that lumps neither become
    charts nor take more texels than their surroundings. Above PACK_AT texels, charts are packed at
    that resolution, with the same share of the square as padding.
    """
    return on_a_page(mesh, *flat_charts(mesh), settings)


def flat_charts(mesh: Mesh) -> tuple[np.ndarray, list[FlatChart]]:
    """The evened surface's vertices (n, 3) and the charts that are cut and laid flat on it.

    Evening takes the lumps off a mesh from photos, and the shape off a coarse one with sharp edges.
    Where areas are laid too unequally by that, vertices are moved by no more than MOVED.
    """
    even = evened(mesh)
    charts = flattened(even, mesh.faces, cut(even, mesh.faces))
    if doublings(mesh, charts) > DISTORTED:
        even = held(even, mesh)
        charts = flattened(even, mesh.faces, cut(even, mesh.faces))
    return even, charts


def doublings(mesh: Mesh, charts: list[FlatChart]) -> float:
    """|log2| of a triangle's area laid flat over its own, at most 5, relative to all triangles', as
    the surface's mean.
    """
    true = face_normals(mesh.vertices, mesh.faces)[1]
    flat = np.zeros(len(mesh.faces))
    for chart in charts:
        corner = np.searchsorted(chart.index, mesh.faces[chart.members])
        flat[chart.members] = triangle_areas(kept(chart, mesh), corner)
    some = true > 0
    ratio = flat[some] / true[some] * true.sum() / flat.sum()
    size = np.abs(np.log2(np.maximum(ratio, 2.0**-5)))
    return float(np.average(np.minimum(size, 5), weights=true[some]))


def on_a_page(
    mesh: Mesh, even: np.ndarray, charts: list[FlatChart], settings: Atlas
) -> tuple[Mesh, int]:
    """The mesh with its charts packed, and their number. A chart that covers a texel of the page
    twice is cut in two, and all are packed anew. even: (n, 3), on which charts are laid flat.
    """
    resolution = min(settings.resolution, PACK_AT)
    padding = int(np.ceil(settings.padding * resolution / settings.resolution))
    pack = PACKERS[settings.packer]
    for _ in range(PAGES):
        corners = [np.searchsorted(c.index, mesh.faces[c.members]) for c in charts]
        placed = pack([(kept(c, mesh), k) for c, k in zip(charts, corners)], resolution, padding)
        found = joined(mesh, charts, placed)
        assert found.uv is not None
        if (rasterize(found.uv, found.faces, PACK_AT) < 2).all():
            break
        once = [(rasterize(uv, k, PACK_AT) < 2).all() for uv, k in zip(placed, corners)]
        charts = [
            part
            for chart, good in zip(charts, once)
            for part in ([chart] if good else cut_again(even, mesh.faces, chart))
        ]
    return found, len(placed)


def joined(mesh: Mesh, charts: list[FlatChart], placed: list[np.ndarray]) -> Mesh:
    """The mesh with each chart's coordinates (k, 2) on the page; vertices are split at seams."""
    faces = np.empty_like(mesh.faces)
    start = 0
    for chart in charts:
        faces[chart.members] = start + np.searchsorted(chart.index, mesh.faces[chart.members])
        start += len(chart.index)
    index = np.concatenate([c.index for c in charts])
    return Mesh(mesh.vertices[index], faces, mesh.normals[index], np.concatenate(placed))


def kept(chart: FlatChart, mesh: Mesh) -> np.ndarray:
    """The chart's u, v (k, 2), enlarged where evening took more than SHRUNK of its length."""
    true = float(np.linalg.norm(np.ptp(mesh.vertices[chart.index], axis=0)))
    laid = float(np.linalg.norm(np.ptp(chart.uv, axis=0)))
    return chart.uv * max(1.0, SHRUNK * true / max(laid, 1e-30))


def evened(mesh: Mesh) -> np.ndarray:
    """The vertices (n, 3), moved EVENING times half-way to their neighbours' mean."""
    links = umbrella(len(mesh.vertices), mesh.faces)
    out = mesh.vertices.astype(float)
    for _ in range(EVENING):
        out = out + 0.5 * (links @ out)
    return out


def held(even: np.ndarray, mesh: Mesh) -> np.ndarray:
    """Evened vertices (n, 3), those that have moved further than MOVED only so far."""
    size = float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))
    moved = even - mesh.vertices
    far = np.linalg.norm(moved, axis=1) > MOVED * size
    out = even.copy()
    out[far] = mesh.vertices[far] + MOVED * size * unit(moved[far])
    return out


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
        result = mesh
        by = dict.fromkeys(("cut_by", "laid_out_by", "packed_by"), "the mesh's own UVs")
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
        result, charts = unwrap(mesh, settings)
        by = made_by(settings.packer)
        assert result.uv is not None
        facts = judge(result.uv, result.faces)

    if not facts["in_range"] or facts["overlap"] > 0.01:
        raise InputError(
            f"the atlas overlaps itself ({100 * facts['overlap']:.1f} % of its texels)",
            "atlas",
            "lower mesh.faces, or give a mesh with good UVs",
        )

    save_mesh(out / "mesh_uv.ply", result)
    save_mesh(out / "mesh_uv.obj", result)
    assert result.uv is not None
    write_png(out / "atlas.png", layout(result.uv, result.faces))
    return {
        "charts": charts,
        "why": why,
        "faces": len(result.faces),
        "vertices": len(result.vertices),
        "mirrored": mirrored_share(result),
    } | (by | facts)


def made_by(packer: str) -> dict[str, str]:
    """Who cuts the surface into charts, lays them flat and packs them."""
    xatlas = f"xatlas {metadata.version('xatlas')}"
    return {
        "cut_by": "heliograph",
        "laid_out_by": "heliograph",
        "packed_by": xatlas if packer == "xatlas" else "heliograph",
    }


def weld(mesh: Mesh) -> Mesh:
    """Undo splits at old seams so that they do not become chart borders."""
    vertices, index = np.unique(np.round(mesh.vertices, 7), axis=0, return_inverse=True)
    faces = index.reshape(-1)[mesh.faces]
    first, second, third = faces.T
    faces = faces[(first != second) & (second != third) & (third != first)]
    return Mesh(vertices, faces, vertex_normals(vertices, faces))
