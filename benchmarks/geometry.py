"""Mesh, its shading normals and cameras against truth: F-score, Chamfer distance, angles, camera
errors.

python -m benchmarks.geometry --mesh work/garden/atlas/mesh_uv.ply \\
    --cameras work/garden/poses/cameras.json --truth examples/garden/truth/mesh.ply \\
    --truth-cameras examples/garden/truth/transforms_truth.json --above 0.004

The reconstruction is brought into the truth's frame by the similarity between camera centres
(Umeyama 1991). Where cameras were not given, a few steps of ICP on mutually near points follow,
because poses and surface may differ by a small rigid motion. Under the true cameras there is none,
and ICP would shift a surface whose truth has layers behind it. `--above` leaves out what lies below
that height, in ICP too: the underside, which no photo shows. Normals are compared in the cameras'
pixels (`benchmarks.normals`).
"""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from benchmarks.normals import NormalCaster, angles, chosen, normal_scores, pixel_rays
from pipeline.base.errors import InputError, run_stage
from pipeline.geometry.cameras import View, load_cameras
from pipeline.geometry.mesh_io import Mesh, load_mesh, sample_surface
from pipeline.surface.preview import caster

SAME = 1e-5  # of the object's size: cameras that lie nearer to the true ones were given


@dataclass
class Similarity:
    """x -> scale rotation x + shift, for points (n, 3)."""

    scale: float
    rotation: np.ndarray
    shift: np.ndarray

    def points(self, x: np.ndarray) -> np.ndarray:
        return self.scale * x @ self.rotation.T + self.shift

    def directions(self, x: np.ndarray) -> np.ndarray:
        return x @ self.rotation.T

    def then(self, after: Similarity) -> Similarity:
        """This one first, then `after`."""
        return Similarity(
            after.scale * self.scale, after.rotation @ self.rotation, after.points(self.shift)
        )


def umeyama(a: np.ndarray, b: np.ndarray) -> Similarity:
    """The similarity that takes a to b in the least-squares sense; a, b (n, 3)."""
    mean_a = a.mean(0)
    mean_b = b.mean(0)
    u, values, vt = np.linalg.svd((b - mean_b).T @ (a - mean_a))
    sign = np.diag([1, 1, np.linalg.det(u @ vt)])
    rotation = u @ sign @ vt
    scale = (values * np.diag(sign)).sum() / ((a - mean_a) ** 2).sum()
    return Similarity(scale, rotation, mean_b - scale * rotation @ mean_a)


def even(count: int) -> np.ndarray:
    """`count` directions (count, 3) spread over the sphere (Fibonacci lattice)."""
    k = np.arange(count) + 0.5
    z = 1 - 2 * k / count
    angle = np.pi * (1 + 5**0.5) * k
    radius = np.sqrt(1 - z**2)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), z], -1)


def outer(mesh: Mesh, points: np.ndarray) -> np.ndarray:
    """Points not buried inside another part: some direction of 64 leaves the mesh unhindered."""
    scene, o3d = caster(mesh)
    free = np.zeros(len(points), bool)
    size = np.linalg.norm(np.ptp(mesh.vertices, axis=0))
    for direction in even(64):
        start = points + 1e-3 * size * direction
        rays = np.concatenate([start, np.broadcast_to(direction, points.shape)], 1)
        hit = scene.cast_rays(o3d.core.Tensor(rays.astype(np.float32)))
        free |= ~np.isfinite(hit["t_hit"].numpy())
    return free


def icp(a: np.ndarray, b: np.ndarray, limit: float, steps: int = 20) -> Similarity:
    """The rigid motion of a onto b by pairs nearer than `limit`. Raises InputError where there are
    fewer than three.
    """
    tree = cKDTree(b)
    motion = Similarity(1.0, np.eye(3), np.zeros(3))
    for _ in range(steps):
        moved = motion.points(a)
        distance, index = tree.query(moved)
        near = distance < limit
        if near.sum() < 3:
            raise InputError(
                "the mesh is not near the truth",
                "benchmarks.geometry",
                "check that mesh and cameras are of one scene, and the truth's of its truth",
            )
        rotation = umeyama(moved[near], b[index[near]]).rotation
        shift = b[index[near]].mean(0) - rotation @ moved[near].mean(0)
        motion = motion.then(Similarity(1.0, rotation, shift))
    return motion


def normal_errors(
    cast: NormalCaster,
    cast_truth: NormalCaster,
    to_truth: Similarity,
    views: list[View],
    above: float,
) -> np.ndarray:
    """Angles (n,) in degrees between the shading normals of a mesh and of the truth, in the pixels
    of `views` that show both, where the truth lies above the height `above`.
    """
    errors = []
    for view in chosen(views):
        origins, directions = pixel_rays(view)
        hit, _, normals = cast(origins, directions)
        moved = to_truth.points(origins[hit]), to_truth.directions(directions[hit])
        true_hit, points, true = cast_truth(*moved)

        high = points[:, 1] > above
        errors.append(angles(to_truth.directions(normals[true_hit][high]), true[high]))
    return np.concatenate(errors)


def surface_scores(accuracy: np.ndarray, completeness: np.ndarray, extent: np.ndarray) -> dict:
    """Scores from distances of found points to the truth (n,), and of true points to what was found
    (m,). extent: the truth's sides (3,); its longest one is the size that distances are held
    against.
    """
    size = extent.max()
    precision = lambda limit: (accuracy < limit).mean()
    recall = lambda limit: (completeness < limit).mean()
    f_score = lambda limit: 2 / (1 / max(precision(limit), 1e-9) + 1 / max(recall(limit), 1e-9))
    chamfer = 50 * (accuracy.mean() + completeness.mean()) / np.linalg.norm(extent)
    return {
        "f1_at_1_percent_of_size": f_score(0.01 * size),
        "f1_at_half_percent": f_score(0.005 * size),
        "chamfer_percent_of_diagonal": chamfer,
        "accuracy_median_percent": 100 * float(np.median(accuracy)) / size,
        "precision_1": float(precision(0.01 * size)),
        "recall_1": float(recall(0.01 * size)),
    }


def true_positions(views: list[View], truth_cameras: Path) -> np.ndarray:
    """Positions (n, 3) of `views` by a transforms file in the truth's frame."""
    frames = json.loads(truth_cameras.read_text())["frames"]
    poses = {Path(f["file_path"]).stem: np.array(f["transform_matrix"]) for f in frames}
    return np.stack([poses[view.name][:3, 3] for view in views])


def compare(
    mesh_file: Path,
    cameras: Path,
    truth_file: Path,
    truth_cameras: Path,
    above: float = -np.inf,
    points: int = 100_000,
) -> dict:
    """Errors of a mesh, of its shading normals and of its cameras. Only truth above the height
    `above` counts; `points` are drawn on the mesh, twice as many on the truth.
    """
    views = load_cameras(cameras).views
    found = np.stack([view.position for view in views])
    true = true_positions(views, truth_cameras)
    to_truth = umeyama(found, true)
    camera_error = np.linalg.norm(to_truth.points(found) - true, axis=1)

    rng = np.random.default_rng(0)
    mesh = load_mesh(mesh_file)
    truth = load_mesh(truth_file)
    a = to_truth.points(sample_surface(mesh, points, rng)[0])
    b = sample_surface(truth, 2 * points, rng)[0]
    b = b[outer(truth, b)]
    b = b[b[:, 1] > above]

    extent = np.ptp(truth.vertices, axis=0)
    if np.median(camera_error) > SAME * extent.max():
        motion = icp(a[a[:, 1] > above], b, 0.02 * float(np.linalg.norm(extent)))
        to_truth = to_truth.then(motion)
        a = motion.points(a)
    a = a[a[:, 1] > above]
    accuracy = cKDTree(b).query(a)[0]
    completeness = cKDTree(a).query(b)[0]

    facts = surface_scores(accuracy, completeness, extent)
    casters = NormalCaster.of_file(mesh_file), NormalCaster(truth)
    facts |= normal_scores(normal_errors(*casters, to_truth, views, above))
    return facts | {
        "camera_error_median_percent": 100 * float(np.median(camera_error)) / extent.max(),
        "scale": float(to_truth.scale),
        "size": float(extent.max()),
    }


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    for name in ("mesh", "cameras", "truth", "truth-cameras"):
        parser.add_argument(f"--{name}", type=Path, required=True)
    parser.add_argument("--above", type=float, default=-np.inf)
    parser.add_argument("--points", type=int, default=100_000)
    args = parser.parse_args()
    files = (args.mesh, args.cameras, args.truth, args.truth_cameras)
    print(json.dumps(compare(*files, args.above, args.points), default=float))


if __name__ == "__main__":
    run_stage(main)
