"""Mesh and cameras against truth: F-score, Chamfer distance, camera errors.

python -m benchmarks.geometry --mesh work/garden/mesh/mesh.ply \\
    --cameras work/garden/poses/cameras.json --truth examples/garden/truth/mesh.ply \\
    --truth-cameras examples/garden/truth/transforms_truth.json --above 0.004

The reconstruction is brought into the truth's frame by the similarity between camera centres
(Umeyama 1991), then by a few steps of ICP on mutually near points, because poses and surface may
differ by a small rigid motion. `--above` leaves out truth surface below that height: the underside,
which no photo shows.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from pipeline.geometry.cameras import load_cameras
from pipeline.geometry.mesh_io import Mesh, load_mesh, sample_surface


def umeyama(a: np.ndarray, b: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Scale, rotation, shift with b = scale R a + shift in the least-squares sense; a, b (n, 3)."""
    mean_a = a.mean(0)
    mean_b = b.mean(0)
    u, values, vt = np.linalg.svd((b - mean_b).T @ (a - mean_a))
    sign = np.diag([1, 1, np.linalg.det(u @ vt)])
    rotation = u @ sign @ vt
    scale = (values * np.diag(sign)).sum() / ((a - mean_a) ** 2).sum()
    return scale, rotation, mean_b - scale * rotation @ mean_a


def even(count: int) -> np.ndarray:
    """`count` directions (count, 3) spread over the sphere (Fibonacci lattice)."""
    k = np.arange(count) + 0.5
    z = 1 - 2 * k / count
    angle = np.pi * (1 + 5**0.5) * k
    radius = np.sqrt(1 - z**2)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), z], -1)


def outer(mesh: Mesh, points: np.ndarray) -> np.ndarray:
    """Points not buried inside another part: some direction of 64 leaves the mesh unhindered."""
    from pipeline.surface.preview import caster

    scene, o3d = caster(mesh)
    free = np.zeros(len(points), bool)
    size = np.linalg.norm(np.ptp(mesh.vertices, axis=0))
    for direction in even(64):
        start = points + 1e-3 * size * direction
        rays = np.concatenate([start, np.broadcast_to(direction, points.shape)], 1)
        hit = scene.cast_rays(o3d.core.Tensor(rays.astype(np.float32)))
        free |= ~np.isfinite(hit["t_hit"].numpy())
    return free


def icp(a: np.ndarray, b: np.ndarray, limit: float, steps: int = 20) -> np.ndarray:
    """Rigidly move a onto b using pairs nearer than `limit`."""
    tree = cKDTree(b)
    for _ in range(steps):
        distance, index = tree.query(a)
        near = distance < limit
        _, rotation, _ = umeyama(a[near], b[index[near]])
        a = (a - a[near].mean(0)) @ rotation.T + b[index[near]].mean(0)
    return a


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


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    for name in ("mesh", "cameras", "truth", "truth-cameras"):
        parser.add_argument(f"--{name}", type=Path, required=True)
    parser.add_argument("--above", type=float, default=-1e9)
    parser.add_argument("--points", type=int, default=100000)
    args = parser.parse_args()

    rig = load_cameras(args.cameras)
    frames = json.loads(args.truth_cameras.read_text())["frames"]
    true_pose = {Path(f["file_path"]).stem: np.array(f["transform_matrix"]) for f in frames}
    found = np.stack([v.position for v in rig.views])
    true = np.stack([true_pose[v.name][:3, 3] for v in rig.views])
    scale, rotation, shift = umeyama(found, true)
    camera_error = np.linalg.norm(scale * found @ rotation.T + shift - true, axis=1)

    rng = np.random.default_rng(0)
    mesh = load_mesh(args.mesh)
    truth = load_mesh(args.truth)
    a = scale * sample_surface(mesh, args.points, rng)[0] @ rotation.T + shift
    b = sample_surface(truth, 2 * args.points, rng)[0]
    b = b[outer(truth, b)]

    extent = np.ptp(truth.vertices, axis=0)
    a = icp(a, b, 0.02 * np.linalg.norm(extent))
    a = a[a[:, 1] > args.above]
    b = b[b[:, 1] > args.above]
    accuracy = cKDTree(b).query(a)[0]
    completeness = cKDTree(a).query(b)[0]

    facts = surface_scores(accuracy, completeness, extent)
    facts |= {
        "camera_error_median_percent": 100 * float(np.median(camera_error)) / extent.max(),
        "scale": scale,
        "size": extent.max(),
    }
    print(json.dumps(facts, default=float))


if __name__ == "__main__":
    main()
