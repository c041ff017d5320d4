"""The plane that the object stands on, among a scene's sparse points."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np

# tries for the ground plane: where it holds 6 % of the points, one in 5000 is of it alone
TRIPLES = 20_000
FEWEST_POINTS = 50  # near the object, for a plane to be sought among
TOLERANCES = 0.004, 0.01  # of the cameras' distance, for points on the ground: fine, coarse


@dataclass(frozen=True)
class Plane:
    """The plane normal . x = offset. normal: unit vector (3,) towards the cameras; inlier_share:
    of the points that it was sought among.
    """

    normal: np.ndarray
    offset: float
    inlier_share: float

    def heights(self, points: np.ndarray) -> np.ndarray:
        """Signed distances (n,) of points (n, 3) from the plane."""
        return points @ self.normal - self.offset


@dataclass(frozen=True)
class NoGround:
    """why: no ground was found, in words; cure: what a user can do about it."""

    why: str
    cure: str

    def facts(self) -> dict:
        """What cameras.json says of it, for the masks stage to tell."""
        return {"no_ground": asdict(self)}


def ground_plane(
    xyz: np.ndarray, centers: np.ndarray, up: np.ndarray, middle: np.ndarray, seed: int
) -> Plane | NoGround:
    """The ground by RANSAC over the points xyz (n, 3), or why there is none. centers (n, 3): of the
    cameras; up: their mean, a unit vector; middle (3,): where they look.

    A ground plane has its normal within 40 degrees of the cameras' mean up, all cameras above it,
    and at least 12 % of the nearer points, or, like white paper with little to match on it, 4 % and
    at most 3 % below: wrong matches lie anywhere. The score is the share of inliers less twice the
    share of points well below. A general RANSAC counts inliers alone and finds a wall or a slope
    where the ground has little texture.

    A fine tolerance comes first, and must leave next to nothing below: seen from afar, a slope
    through a low object holds more points within the coarse one than the ground it stands on.
    """
    distance = np.median(np.linalg.norm(centers - middle, axis=1))
    near = xyz[np.linalg.norm(xyz - middle, axis=1) < 1.5 * distance]
    if len(near) < FEWEST_POINTS:
        return NoGround(
            f"only {len(near)} points near the object were matched between photos, and "
            f"{FEWEST_POINTS} are needed to seek a plane",
            "photograph on a table with texture, newspaper for one, and with more overlap",
        )

    for share in TOLERANCES:
        tolerance = share * distance
        start = _best_of_triples(near, centers, up, tolerance, np.random.default_rng(seed))
        if start is None:
            continue
        n, offset = _refit(near, *start, up, tolerance)
        inliers, below = _inliers_and_below(near, n, offset, tolerance)
        plane = Plane(n, float(offset), inliers)
        if inliers >= 0.12 and below < 0.02:
            return plane

    if start is None:
        return NoGround(
            f"none of the planes among {len(near)} matched points lies below all cameras with next "
            "to nothing under it",
            "photograph from above the table that the object stands on, with the table in sight",
        )
    bare = inliers >= 0.04 and inliers * len(near) >= 80 and below < 0.03
    if inliers >= 0.12 or bare:
        return plane
    return NoGround(
        f"the best plane holds {100 * inliers:.0f} % of {len(near)} matched points, with "
        f"{100 * below:.0f} % below it: the points are not of a level ground",
        "photograph on a level table with texture, newspaper for one, that the photos show more of",
    )


def _inliers_and_below(
    points: np.ndarray, n: np.ndarray, offset: float, tolerance: float
) -> tuple[float, float]:
    """Shares of the points (n, 3) that lie on a plane, and well below it."""
    height = points @ n - offset
    inliers = (np.abs(height) < tolerance).mean()
    return float(inliers), float((height < -3 * tolerance).mean())


def _best_of_triples(
    points: np.ndarray,
    centers: np.ndarray,
    up: np.ndarray,
    tolerance: float,
    rng: np.random.Generator,
) -> tuple[np.ndarray, float] | None:
    """Normal (3,) and offset of the best ground through three of the points, or None."""
    best = None
    best_score = 0.0
    for _ in range(TRIPLES):
        a, b, c = points[rng.choice(len(points), 3, replace=False)]
        n = np.cross(b - a, c - a)
        n = n / (np.linalg.norm(n) + 1e-12)
        n = n * np.sign(n @ up)
        if n @ up < np.cos(np.radians(40)) or (centers @ n).min() < a @ n:
            continue

        inliers, below = _inliers_and_below(points, n, a @ n, tolerance)
        score = inliers - 2.0 * below
        if score > best_score:
            best_score = score
            best = (n, a @ n)
    return best


def _refit(
    points: np.ndarray, n: np.ndarray, offset: float, up: np.ndarray, tolerance: float
) -> tuple[np.ndarray, float]:
    """Normal and offset of the plane fitted to its own inliers, five times over."""
    for _ in range(5):
        inliers = points[np.abs(points @ n - offset) < tolerance]
        center = inliers.mean(0)
        n = np.linalg.svd(inliers - center, full_matrices=False)[2][2]
        n = n * np.sign(n @ up)
        offset = center @ n
    return n, offset
