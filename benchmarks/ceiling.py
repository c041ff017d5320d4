"""What a surface made from photos allows: the true materials on it, under the true lights.

python -m benchmarks.ceiling --scenes FOLDER/* --assets ASSETS --work WORK --out rows.json

The scenes are those of benchmarks.from_photos, ASSETS/<name> what benchmarks.make_scene rendered
them from, and WORK/<name>_own the finished run without the true mesh. Every texel of the run's
atlas takes base colour, roughness and metallic of the nearest point of the true surface. What is
then still wrong under new light is the surface's, positions and normals; what the run's own samples
lose beyond it is the light's and the materials'.

A row: `scene`; `distance`, median and mean over the texels to the true surface, shares of its
diagonal; `scores` of pipeline/render/declared.py.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from benchmarks.from_photos import OWN, SPP
from benchmarks.scenes import machine
from benchmarks.true_maps import texture_values
from pipeline.base.errors import run_stage
from pipeline.base.files import write_json
from pipeline.base.progress import progress
from pipeline.base.runtime import set_threads
from pipeline.geometry.cameras import Y_FROM_Z_UP
from pipeline.geometry.mesh_io import Mesh, load_mesh
from pipeline.render.renderer import Explanation, Renderer
from pipeline.report.score import MAX_DEPTH, score_explanation
from pipeline.report.truth import truth_of_work
from pipeline.surface.raster import texel_faces

MAPS = ("base_color", "roughness", "metallic")
POINTS = 1_500_000  # on the true surface, of which the nearest one counts
SIDE = 1024  # texels


def spread_points(mesh: Mesh, count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Random points of a mesh with UVs, evenly by area, (count, 3), and their UVs (count, 2)."""
    assert mesh.uv is not None
    rng = np.random.default_rng(seed)
    corner = mesh.vertices[mesh.faces]
    area = np.linalg.norm(
        np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1
    )
    face = mesh.faces[rng.choice(len(area), count, p=area / area.sum())]
    root, along = np.sqrt(rng.random(count)), rng.random(count)
    weight = np.stack([1 - root, root * (1 - along), root * along], 1)[..., None]
    return (mesh.vertices[face] * weight).sum(1), (mesh.uv[face] * weight).sum(1)


def texel_points(mesh: Mesh, side: int) -> tuple[np.ndarray, np.ndarray]:
    """Where every texel of a mesh lies (side, side, 3), and which ones lie on it (side, side)."""
    face, weight = texel_faces(mesh, side)
    corner = mesh.vertices[mesh.faces[np.maximum(face, 0)]]
    return (corner * weight[..., None]).sum(-2), face >= 0


def carried(asset: Path, mesh: Mesh, side: int) -> tuple[list[np.ndarray], np.ndarray]:
    """The asset's MAPS at the texels of another mesh of it, (side, side, 3 or 1), beside the charts
    as at their edge; and how far every texel is from the asset (n,), shares of its diagonal.

    asset: a folder with mesh.ply (Z-up) and PNGs; mesh: Y-up.
    """
    true = load_mesh(asset / "mesh.ply")
    points, uv = spread_points(true, POINTS, 0)
    at, covered = texel_points(mesh, side)
    distance, nearest = cKDTree(points @ Y_FROM_Z_UP[:3, :3].T).query(at[covered])
    beside = ndimage.distance_transform_edt(~covered, return_distances=False, return_indices=True)
    maps = []
    for name in MAPS:
        values = texture_values(asset / f"{name}.png", uv[nearest])
        whole = np.zeros((side, side, values.shape[1]), np.float32)
        whole[covered] = values
        maps.append(whole[tuple(beside)])
    return maps, distance / np.linalg.norm(np.ptp(true.vertices, axis=0))


def row_of(scene: Path, asset: Path, work: Path) -> dict:
    """The row of a finished run in `work` of a scene folder with truth."""
    truth = truth_of_work(scene, work)
    light, mesh = truth.known_light(), work / "atlas" / "mesh_uv.ply"
    (color, roughness, metallic), distance = carried(asset, load_mesh(mesh), SIDE)
    x = Explanation(light.astype(np.float32), color, roughness[..., 0], metallic[..., 0])
    scored = score_explanation(Renderer(mesh, SIDE, len(light), MAX_DEPTH), x, truth, SPP)
    far = {"median": float(np.median(distance)), "mean": float(distance.mean())}
    return {"scene": scene.name, "distance": far, "scores": scored.values}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--scenes", type=Path, nargs="+", required=True, help="scene folders")
    parser.add_argument("--assets", type=Path, required=True, help="what they were rendered from")
    parser.add_argument("--work", type=Path, default=Path("work"), help="of the runs")
    parser.add_argument("--out", type=Path, required=True, help="JSON file for all rows")
    args = parser.parse_args()

    set_threads(2)
    rows = []
    for scene in progress([path.resolve() for path in args.scenes], "scenes"):
        work = args.work / f"{scene.name}_{OWN}"
        rows.append(row_of(scene, args.assets / scene.name, work))
        write_json(args.out, {"machine": machine(), "rows": rows})


if __name__ == "__main__":
    run_stage(main)
