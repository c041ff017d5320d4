"""Where a set of cameras stands, looks and takes for up."""

from __future__ import annotations

import numpy as np


def positions(poses: list[np.ndarray]) -> np.ndarray:
    """Camera centres (n, 3) of world-to-camera matrices."""
    return np.stack([-p[:3, :3].T @ p[:3, 3] for p in poses])


def axes_meeting_point(poses: list[np.ndarray]) -> np.ndarray:
    """Point (3,) nearest to all optical axes in the least-squares sense."""
    centers = positions(poses)
    axes = np.stack([p[2, :3] for p in poses])
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]  # projections across each axis

    matrix = across.sum(0) + 1e-9 * np.eye(3)
    return np.linalg.solve(matrix, (across @ centers[..., None]).sum(0)[:, 0])


def mean_up(poses: list[np.ndarray]) -> np.ndarray:
    """Mean of the cameras' up directions, a unit vector (3,)."""
    up = -np.stack([p[1, :3] for p in poses]).mean(0)
    return up / np.linalg.norm(up)


def middle_and_distance(poses: list[np.ndarray]) -> tuple[np.ndarray, float]:
    """Where the optical axes meet (3,), and the cameras' median distance from there."""
    middle = axes_meeting_point(poses)
    return middle, np.median(np.linalg.norm(positions(poses) - middle, axis=1))
