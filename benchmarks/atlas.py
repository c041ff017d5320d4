"""Routes from a mesh to one texture atlas, side by side: who cuts, lays out and packs the charts.

python -m benchmarks.atlas --folders work/garden ASSETS/suzanne --out rows.json

A folder is a scene's (its mesh stage's mesh/mesh.ply is read) or holds mesh.ply; its own UVs are
taken off, and vertices that they split are joined. docs/results.md says what a route is. A row has
charts; utilisation (share of a page of 1024 texels that triangles cover), overlap (share of these
texels that more than one covers), mirrored (share of the covered area), stretch of angles (ratio of
the singular values of the map from surface to page, at most 10; 1 keeps angles) and of areas
(|log2| of texels per area, over the whole page's, at most 5), both as means over the surface, and
processor seconds. Padding is 4 texels.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np

from pipeline.base.config import Atlas
from pipeline.base.errors import InputError, run_stage
from pipeline.base.files import write_json
from pipeline.base.progress import progress
from pipeline.geometry.mesh_io import Mesh, load_mesh
from pipeline.geometry.normal_maps import mirrored_share
from pipeline.surface.atlas import flat_charts, joined, judge, on_a_page, weld
from pipeline.surface.charts import cut
from pipeline.surface.pack import chart_area

SETTINGS = Atlas()
TIGHT = Atlas(packer="tight")
TRIES = 9  # of the scale, where a route asks for one page of a given size
Unwrapped = tuple[Mesh, int]


def processor_seconds() -> float:
    """Of this process and of those it has started, such as the packer's, that have ended."""
    spent = os.times()
    return spent.user + spent.system + spent.children_user + spent.children_system


class Charts:
    """The cutter's charts of a mesh, made once; corners: each one's triangles as indices of its own
    vertices; seconds: what they took.
    """

    def __init__(self, mesh: Mesh):
        start = processor_seconds()
        self.mesh = mesh
        self.even, self.flat = flat_charts(mesh)
        self.cut = cut(self.even, mesh.faces)
        self.corners = [np.searchsorted(c.index, mesh.faces[c.members]) for c in self.flat]
        self.seconds = processor_seconds() - start


def generated(parts: list[tuple[np.ndarray, np.ndarray]], turned: bool):
    """xatlas's atlas of parts: vertices (n, 3) and triangles (m, 3) each; charts may be `turned`,
    which mirrors them.
    """
    import xatlas

    atlas = xatlas.Atlas()
    for vertices, faces in parts:
        atlas.add_mesh(vertices.astype(np.float32), faces.astype(np.uint32))
    options = xatlas.PackOptions()
    options.resolution = SETTINGS.resolution
    options.padding = SETTINGS.padding
    options.rotate_charts = turned
    atlas.generate(xatlas.ChartOptions(), options)
    return atlas


def collected(mesh: Mesh, atlas, parts: list[np.ndarray], members: list[np.ndarray]) -> Unwrapped:
    """xatlas's result as one mesh. parts: indices of each part's vertices; members: its faces."""
    square = np.array([atlas.width, atlas.height]) / max(atlas.width, atlas.height)
    faces = np.empty_like(mesh.faces)
    index, uv, start = [], [], 0
    for k, (part, member) in enumerate(zip(parts, members)):
        found, corner, places = atlas.get_mesh(k)
        faces[member] = corner.astype(np.int64) + start
        start += len(found)
        index.append(part[found])
        uv.append(places.astype(float) * square)
    every = np.concatenate(index)
    whole = Mesh(mesh.vertices[every], faces, mesh.normals[every], np.concatenate(uv))
    return whole, atlas.chart_count


def xatlas_of(vertices: np.ndarray, mesh: Mesh) -> Unwrapped:
    atlas = generated([(vertices, mesh.faces)], True)
    everything = np.arange(len(mesh.vertices))
    return collected(mesh, atlas, [everything], [np.arange(len(mesh.faces))])


def xatlas_on_regions(charts: Charts) -> Unwrapped:
    mesh = charts.mesh
    members = [np.flatnonzero(charts.cut == k) for k in range(charts.cut.max() + 1)]
    parts = [np.unique(mesh.faces[member]) for member in members]
    corners = [np.searchsorted(part, mesh.faces[m]) for part, m in zip(parts, members)]
    atlas = generated([(charts.even[part], k) for part, k in zip(parts, corners)], False)
    return collected(mesh, atlas, parts, members)


def xatlas_once(charts: Charts) -> Unwrapped:
    """In the mesh's unit, on one page of the size asked for, at the largest scale that fits."""
    import xatlas

    uv = np.concatenate([c.uv for c in charts.flat])
    first = np.cumsum([0] + [len(c.index) for c in charts.flat])
    faces = np.concatenate([start + k for start, k in zip(first, charts.corners)])
    number = np.repeat(np.arange(len(charts.flat)), [len(k) for k in charts.corners])[:, None]
    options = xatlas.PackOptions()
    options.resolution = SETTINGS.resolution
    options.padding = SETTINGS.padding
    options.bruteForce = True
    options.rotate_charts = False
    high = SETTINGS.resolution * (1 / chart_area(uv, faces)) ** 0.5
    low, best = 0.0, None
    for _ in range(TRIES):
        options.texels_per_unit = 0.5 * (low + high)
        atlas = xatlas.Atlas()
        atlas.add_uv_mesh(uv.astype(np.float32), faces.astype(np.uint32), number.astype(np.uint32))
        atlas.generate(xatlas.ChartOptions(), options)
        if atlas.atlas_count > 1:
            high = options.texels_per_unit
            continue
        low = options.texels_per_unit
        index, _, places = atlas.get_mesh(0)
        best = uv.copy()
        best[index] = places
    if best is None:
        raise InputError("no scale fits one page", "xatlas", "lower the padding")
    return joined(charts.mesh, charts.flat, np.split(best, first[1:-1])), len(charts.flat)


ROUTES: dict[str, Callable[[Charts], Unwrapped]] = {
    "default": lambda charts: on_a_page(charts.mesh, charts.even, charts.flat, SETTINGS),
    "own packer": lambda charts: on_a_page(charts.mesh, charts.even, charts.flat, TIGHT),
    "charts, xatlas once": xatlas_once,
    "xatlas alone": lambda charts: xatlas_of(charts.mesh.vertices, charts.mesh),
    "xatlas, evened": lambda charts: xatlas_of(charts.even, charts.mesh),
    "regions, xatlas": xatlas_on_regions,
}
UNCUT = {"xatlas alone", "xatlas, evened"}  # without the cutter, whose time does not count


def stretch(mesh: Mesh) -> dict[str, float]:
    """Means over the surface of how the map to the page stretches angles and areas."""
    assert mesh.uv is not None
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    one, other = b - a, c - a
    normal = np.cross(one, other)
    double = np.linalg.norm(normal, axis=1)
    some = double > 1e-12 * double.max()
    along = one[some] / np.linalg.norm(one[some], axis=1, keepdims=True)
    across = np.cross(normal[some] / double[some, None], along)
    local = np.empty((int(some.sum()), 2, 2))
    for column, edge in enumerate((one[some], other[some])):
        local[:, 0, column] = (edge * along).sum(1)
        local[:, 1, column] = (edge * across).sum(1)
    page = mesh.uv[mesh.faces[some]]
    laid = np.stack([page[:, 1] - page[:, 0], page[:, 2] - page[:, 0]], -1)
    large, small = np.linalg.svd(laid @ np.linalg.inv(local), compute_uv=False).T
    weight = double[some] / double[some].sum()
    size = large * small / (weight * large * small).sum()
    angle = np.minimum(large / np.maximum(small, 1e-30), 10)
    area = np.minimum(np.abs(np.log2(np.maximum(size, 1e-30))), 5)
    return {
        "angle_stretch": float((weight * angle).sum()),
        "area_stretch": float((weight * area).sum()),
    }


def measured(charts: Charts, name: str) -> dict:
    """One route's figures on one mesh; `failed` says why where it makes no atlas."""
    start = processor_seconds() - (0 if name in UNCUT else charts.seconds)
    try:
        found, count = ROUTES[name](charts)
    except InputError as error:
        return {"failed": str(error)}
    seconds = processor_seconds() - start
    assert found.uv is not None
    facts = judge(found.uv, found.faces)
    return (
        {"charts": count, "seconds": seconds, "mirrored": mirrored_share(found)}
        | {key: facts[key] for key in ("utilisation", "overlap")}
        | stretch(found)
    )


def bare_mesh(folder: Path) -> Mesh:
    """The mesh of a folder without UVs."""
    path = next(
        (p for p in (folder / "mesh" / "mesh.ply", folder / "mesh.ply") if p.exists()), None
    )
    if path is None:
        raise InputError("there is no mesh.ply", folder, "give a scene's folder in work/")
    mesh = load_mesh(path)
    return mesh if mesh.uv is None else weld(mesh)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--folders", nargs="+", type=Path, required=True)
    parser.add_argument("--routes", nargs="+", choices=ROUTES, default=list(ROUTES))
    parser.add_argument("--out", type=Path, required=True)
    args = parser.parse_args()
    few = bare_mesh(args.folders[0])
    warm = Charts(Mesh(few.vertices, few.faces[:200], few.normals))  # numba compiles
    for name in args.routes:
        measured(warm, name)
    rows = []
    for folder in progress(args.folders, "meshes"):
        mesh = bare_mesh(folder)
        charts = Charts(mesh)
        about = {"mesh": folder.name, "faces": len(mesh.faces)}
        for name in args.routes:
            rows.append(about | {"route": name} | measured(charts, name))
            write_json(args.out, {"rows": rows})


if __name__ == "__main__":
    run_stage(main)
