"""The sphere that holds the object, from a scene's sparse points, cameras and ground."""

from __future__ import annotations

import numpy as np

from pipeline.geometry.cameras import projected
from pipeline.photos.given_cameras import Lens
from pipeline.photos.ground_plane import Plane
from pipeline.photos.viewpoints import mean_up, middle_and_distance

MARGIN = 1.25  # of the sphere that holds the points: the object has parts without any


def object_points(
    xyz: np.ndarray,
    poses: list[np.ndarray],
    lenses: list[Lens],
    plane: Plane | None,
    masks: list[np.ndarray] | None,
) -> np.ndarray:
    """Sparse points that belong to the object: inside the masks if there are any, else above the
    ground and near the middle of the scene.
    """
    if masks is not None:
        return _points_in_masks(xyz, poses, lenses, masks)

    middle, distance = middle_and_distance(poses)
    if plane is not None:
        up = plane.normal
        above = plane.heights(xyz) > 0.02 * distance
    else:
        up = mean_up(poses)
        above = np.ones(len(xyz), bool)

    height = (xyz - middle) @ up
    sideways = (xyz - middle) - height[:, None] * up
    central = (np.linalg.norm(sideways, axis=1) < 0.4 * distance) & (height < 0.6 * distance)
    return xyz[above & central]


def _points_in_masks(
    xyz: np.ndarray, poses: list[np.ndarray], lenses: list[Lens], masks: list[np.ndarray]
) -> np.ndarray:
    """Points inside 90 % of the masks (uint8) of the two or more views whose frame holds them."""
    inside = np.zeros(len(xyz))
    total = np.zeros(len(xyz))

    for pose, lens, mask in zip(poses, lenses, masks):
        at, depth = projected(xyz, pose, lens.fx, lens.fy, lens.cx, lens.cy)
        u, v = at.T
        seen = (depth > 0) & (u >= 0) & (v >= 0) & (u < lens.width) & (v < lens.height)
        total += seen

        scale = mask.shape[1] / lens.width
        row = (v[seen] * scale).astype(int).clip(0, mask.shape[0] - 1)
        column = (u[seen] * scale).astype(int).clip(0, mask.shape[1] - 1)
        inside[seen] += mask[row, column] > 127

    return xyz[(inside >= 0.9 * total) & (total >= 2)]


def main_cluster(points: np.ndarray, bandwidth: float) -> np.ndarray:
    """The largest group of points linked by steps shorter than `bandwidth`, and groups of at least
    a third its size.
    """
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    if len(points) > 5000:  # neighbour pairs grow with the square of the density
        points = points[np.random.default_rng(0).choice(len(points), 5000, replace=False)]

    tree = cKDTree(points)
    near = tree.sparse_distance_matrix(tree, bandwidth, output_type="coo_matrix")
    label = connected_components(near.tocsr(), directed=False)[1]
    counts = np.bincount(label)
    return points[counts[label] >= counts.max() / 3]


def object_sphere(
    points: np.ndarray, poses: list[np.ndarray], plane: Plane | None
) -> tuple[np.ndarray, float, str]:
    """Centre and radius that hold the object's sparse points, and how they were found."""
    middle, distance = middle_and_distance(poses)
    if len(points) >= 30:
        points = main_cluster(points, 0.06 * distance)
    if len(points) < 30:
        return middle, 0.35 * float(distance), "optical axes (too few object points)"

    if plane is not None:  # the object's foot on the ground belongs to it
        foot = points - plane.heights(points)[:, None] * plane.normal
        points = np.concatenate([points, foot])

    low, high = np.percentile(points, [1, 99], axis=0)
    center = 0.5 * (low + high)
    radius = float(np.percentile(np.linalg.norm(points - center, axis=1), 99))
    return center, radius, f"{len(points)} sparse points"
