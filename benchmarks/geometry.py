"""Mesh and cameras against truth: F-score, Chamfer distance, camera errors.

python -m benchmarks.geometry --mesh work/garden/mesh/mesh.ply --cameras work/garden/poses/cameras.json \\
    --truth examples/garden/truth/mesh.ply --truth-cameras
    examples/garden/truth/transforms_truth.json --above 0.004

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
    """Scale, rotation, shift with b = s R a + t in the least-squares sense; a, b (n, 3)."""
    ma, mb = a.mean(0), b.mean(0)
    u, d, vt = np.linalg.svd((b - mb).T @ (a - ma))
    sign = np.diag([1, 1, np.linalg.det(u @ vt)])
    rotation = u @ sign @ vt
    scale = (d * np.diag(sign)).sum() / ((a - ma) ** 2).sum()
    return scale, rotation, mb - scale * rotation @ ma


def even(count: int) -> np.ndarray:
    """`count` directions (count, 3) spread over the sphere (Fibonacci lattice)."""
    k = np.arange(count) + 0.5
    z, angle = 1 - 2 * k / count, np.pi * (1 + 5**0.5) * k
    return np.stack([np.sqrt(1 - z**2) * np.cos(angle), np.sqrt(1 - z**2) * np.sin(angle), z], -1)


def outer(mesh: Mesh, points: np.ndarray) -> np.ndarray:
    """Points not buried inside another part: some direction of 64 leaves the mesh unhindered."""
    from pipeline.surface.preview import caster

    scene, o3d = caster(mesh)
    free = np.zeros(len(points), bool)
    size = np.linalg.norm(np.ptp(mesh.vertices, axis=0))
    for d in even(64):
        rays = np.concatenate(
            [points + 1e-3 * size * d, np.broadcast_to(d, points.shape)], 1
        ).astype(np.float32)
        free |= ~np.isfinite(scene.cast_rays(o3d.core.Tensor(rays))["t_hit"].numpy())
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


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    for name in ("mesh", "cameras", "truth", "truth-cameras"):
        parser.add_argument(f"--{name}", type=Path, required=True)
    parser.add_argument("--above", type=float, default=-1e9)
    parser.add_argument("--points", type=int, default=100000)
    args = parser.parse_args()
    rig, frames = load_cameras(args.cameras), json.loads(args.truth_cameras.read_text())["frames"]
    truth_pose = {Path(f["file_path"]).stem: np.array(f["transform_matrix"]) for f in frames}
    ours = np.stack([v.position for v in rig.views])
    theirs = np.stack([truth_pose[v.name][:3, 3] for v in rig.views])
    s, r, t = umeyama(ours, theirs)
    rng, mesh, truth = np.random.default_rng(0), load_mesh(args.mesh), load_mesh(args.truth)
    a = s * sample_surface(mesh, args.points, rng)[0] @ r.T + t
    b = sample_surface(truth, 2 * args.points, rng)[0]
    b = b[outer(truth, b)]
    diagonal, size = (
        np.linalg.norm(np.ptp(truth.vertices, axis=0)),
        np.ptp(truth.vertices, axis=0).max(),
    )
    a = icp(a, b, 0.02 * diagonal)
    a, b = a[a[:, 1] > args.above], b[b[:, 1] > args.above]
    accuracy, completeness = cKDTree(b).query(a)[0], cKDTree(a).query(b)[0]
    score = lambda at: (
        2 / (1 / max((accuracy < at).mean(), 1e-9) + 1 / max((completeness < at).mean(), 1e-9))
    )
    print(
        json.dumps(
            {
                "f1_at_1_percent_of_size": score(0.01 * size),
                "f1_at_half_percent": score(0.005 * size),
                "chamfer_percent_of_diagonal": 50
                * (accuracy.mean() + completeness.mean())
                / diagonal,
                "accuracy_median_percent": 100 * float(np.median(accuracy)) / size,
                "precision_1": float((accuracy < 0.01 * size).mean()),
                "recall_1": float((completeness < 0.01 * size).mean()),
                "camera_error_median_percent": 100
                * float(np.median(np.linalg.norm(s * ours @ r.T + t - theirs, axis=1)))
                / size,
                "scale": s,
                "size": size,
            },
            default=float,
        )
    )


if __name__ == "__main__":
    main()
