"""Ground or above it, by matching: what lies on the ground looks alike in other photos when the
ground plane carries it over; what stands above the ground does not, but matches at a depth of its
own.

Planes swept through the object's sphere (Collins 1996) against the one plane of the ground, each by
the homography that it induces (Hartley and Zisserman, Multiple View Geometry, 13.1). A pixel on
bare ground matches best on the ground whatever shadow lies there, and one of the object matches
better elsewhere or, where it is glossy, nowhere. Where nothing can be matched, on blank paper,
both costs are the same and the pixel says nothing. Blank paper may also be brighter in one photo
than in the next; where a blank window matches at no depth, hue alone is held against the ground.
Rays that pass the ground beside the object may end at a wall or a hedge: for them what lies behind
the object's sphere stands for the ground.

Letters: K (3, 3) intrinsics, R (3, 3) and t (3,) from the reference camera to another one, n unit
normal (3,) and d distance of a plane n.x = d in the reference camera's frame.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import cv2
import numpy as np

from pipeline.geometry.cameras import Rig, View
from pipeline.masks.ground import sphere_region

LONGEST = 320  # pixels along the longer side of the region that is matched
LEVELS = 36  # depths through the sphere
NEIGHBOURS = 4
ANGLES = (4.0, 16.0, 45.0)  # least, best and largest angle between matched views, degrees
ABOVE = 0.025  # sphere radii above the ground from which on a point stands above it
UNMATCHED = 0.6  # cost at and above which two places do not look alike
VICINITY = 1.5  # sphere radii from the object within which the ground is taken for certain
GAIN = 8.0  # log-odds per unit of cost
WINDOW = 7  # pixels
NOISE = 4.0  # variance of lightness in a window from which on it shows a pattern


@dataclass
class Region:
    """The part of a view that is matched: its photo as CIELAB (h, w, 3), K of its pixels, and the
    box (y0, y1, x0, x1) in the photo at working size that it stands for.
    """

    lab: np.ndarray
    K: np.ndarray
    box: tuple[int, int, int, int]
    scale: float


def neighbours(rig: Rig, k: int) -> list[int]:
    """Indices of up to NEIGHBOURS views that look at the object from nearest to 16 degrees beside
    view k.
    """
    out = np.stack([v.position for v in rig.views]) - rig.center
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    angle = np.degrees(np.arccos(np.clip(out @ out[k], -1, 1)))

    least, best, largest = ANGLES
    usable = np.where((angle >= least) & (angle <= largest))[0]
    order = np.argsort(np.abs(np.log(angle[usable] / best)), kind="stable")
    return usable[order][:NEIGHBOURS].tolist()


def region_of(rig: Rig, view: View, lab: np.ndarray, longest: int) -> Region | None:
    """What is to be matched of a photo: the box around the object's sphere, at `longest` pixels at
    most. None where the sphere is out of sight.
    """
    height, width = lab.shape[:2]
    rows, columns = np.where(sphere_region(view, rig, (width, height)))
    if not len(rows):
        return None

    box = (int(rows.min()), int(rows.max()) + 1, int(columns.min()), int(columns.max()) + 1)
    y0, y1, x0, x1 = box
    scale = min(1.0, longest / max(y1 - y0, x1 - x0))
    size = (max(1, round((x1 - x0) * scale)), max(1, round((y1 - y0) * scale)))
    small = cv2.resize(lab[y0:y1, x0:x1], size, interpolation=cv2.INTER_AREA)

    ratio_x = size[0] / (x1 - x0)
    ratio_y = size[1] / (y1 - y0)
    crop = np.array([[ratio_x, 0, -x0 * ratio_x], [0, ratio_y, -y0 * ratio_y], [0, 0, 1]])
    return Region(small, crop @ view.at_size(width, height).K, box, scale)


def _mean(image: np.ndarray, window: int = WINDOW) -> np.ndarray:
    return cv2.boxFilter(image, -1, (window, window))


class Matcher:
    """Costs of planes between one view's region and its neighbours."""

    def __init__(self, region: Region, view: View, others: Iterable[tuple[View, np.ndarray]]):
        self.lab = region.lab
        self.inverse = np.linalg.inv(region.K)
        self.mean = _mean(self.lab[..., 0])
        self.variance = _mean(self.lab[..., 0] ** 2) - self.mean**2
        self.others = [self._other(region, view, *other) for other in others]

    @staticmethod
    def _other(region: Region, view: View, other: View, lab: np.ndarray) -> tuple:
        """Photo, K, R, t of a neighbour at the region's scale."""
        size = [max(1, round(side * region.scale)) for side in lab.shape[1::-1]]
        small = cv2.resize(lab, size, interpolation=cv2.INTER_AREA)
        motion = other.world_to_camera @ np.linalg.inv(view.world_to_camera)
        return small, other.at_size(*size).K, motion[:3, :3], motion[:3, 3]

    def cost(self, n: np.ndarray, d: float, brightness: bool = True) -> np.ndarray:
        """Cost (h, w) of the plane n.x = d: mean over the two neighbours that match best, so that
        one may be hidden; infinite where fewer than two look. brightness: whether places that are
        not equally bright look unlike.
        """
        best = np.full(self.lab.shape[:2], np.inf, np.float32)
        second = best.copy()
        for photo, K, R, t in self.others:
            homography = K @ (R + np.outer(t, n) / d) @ self.inverse
            found = self._compare(photo, homography, 0.5 if brightness else 0.0)
            second = np.minimum(second, np.maximum(best, found))
            best = np.minimum(best, found)
        return 0.5 * (best + second)

    def _compare(self, photo: np.ndarray, homography: np.ndarray, weight: float) -> np.ndarray:
        """1 - NCC of lightness (halved) plus the mean colour difference, in which lightness has
        that weight; infinite off the photo.
        """
        height, width = self.lab.shape[:2]
        shift = np.array([[1, 0, -0.5], [0, 1, -0.5], [0, 0, 1]])  # OpenCV's centres are integers
        carried = cv2.warpPerspective(
            photo,
            shift @ homography @ np.linalg.inv(shift),
            (width, height),
            flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
            borderValue=(-1e3, 0, 0),
        )
        lightness = carried[..., 0]
        mean = _mean(lightness)
        variance = np.maximum(_mean(lightness * lightness) - mean * mean, 0)
        covariance = _mean(self.lab[..., 0] * lightness) - self.mean * mean
        # blank windows correlate with nothing
        ncc = covariance / np.sqrt((self.variance + NOISE) * (variance + NOISE))

        difference = cv2.transform(cv2.absdiff(self.lab, carried), np.array([[weight, 1, 1]]))
        colour = _mean(np.minimum(difference, 25), 5) / 25
        out = 0.5 * (1 - ncc) + colour
        out[lightness < -5] = np.inf
        return out


def ground_or_above(rig: Rig, k: int, labs: dict[str, np.ndarray], height: float) -> np.ndarray:
    """Log-odds (h, w) in [-3, 3] that a pixel of view k shows something above the ground y =
    height; 0 where nothing can be said, as outside the sphere. labs: photos in CIELAB.
    """
    view = rig.views[k]
    lab = labs[view.name]
    out = np.zeros(lab.shape[:2], np.float32)
    beside = [(rig.views[j], labs[rig.views[j].name]) for j in neighbours(rig, k)]
    region = region_of(rig, view, lab, LONGEST)
    if region is None or len(beside) < 2:
        return out

    matcher = Matcher(region, view, beside)
    ground = _ground_cost(matcher, view, height)
    passing = ~_meets_ground(matcher, view, rig, height)
    if passing.any():
        coarse = region_of(rig, view, lab, LONGEST // 2)
        assert coarse is not None
        far = cv2.resize(
            _cost_behind(Matcher(coarse, view, beside), view, rig), passing.shape[::-1]
        )
        ground = np.where(passing, np.minimum(np.minimum(ground, far), UNMATCHED), ground)

    above = _least_cost_above(matcher, view, rig, height)
    unmatched = (matcher.variance < NOISE) & (above >= UNMATCHED)
    by_hue = np.minimum(ground, _ground_cost(matcher, view, height, brightness=False))
    ground = np.where(unmatched, by_hue, ground)
    odds = np.clip(GAIN * (ground - np.minimum(above, UNMATCHED)), -3, 3)
    odds = cv2.blur(np.where(np.isfinite(ground), odds, 0).astype(np.float32), (3, 3))

    y0, y1, x0, x1 = region.box
    out[y0:y1, x0:x1] = cv2.resize(odds, (x1 - x0, y1 - y0), interpolation=cv2.INTER_LINEAR)
    return out


def _rays(matcher: Matcher, view: View) -> np.ndarray:
    """World directions (h, w, 3) through the region's pixels, of unit depth."""
    h, w = matcher.lab.shape[:2]
    u, v = np.meshgrid(np.arange(w) + 0.5, np.arange(h) + 0.5)
    in_camera = np.stack([u, v, np.ones_like(u)], -1) @ matcher.inverse.T
    return in_camera @ view.world_to_camera[:3, :3]


def _ground_cost(
    matcher: Matcher, view: View, height: float, brightness: bool = True
) -> np.ndarray:
    """Cost (h, w) of the ground, infinite where the ray does not meet it or too few photos see
    it. brightness: as Matcher.cost has it.
    """
    n = view.world_to_camera[:3, 1]
    cost = matcher.cost(n, height + float(n @ view.world_to_camera[:3, 3]), brightness)
    return np.where(_rays(matcher, view)[..., 1] < -1e-3, cost, np.inf).astype(np.float32)


def _meets_ground(matcher: Matcher, view: View, rig: Rig, height: float) -> np.ndarray:
    """Which rays (h, w) meet the ground below or near the object."""
    rays = _rays(matcher, view)
    fall = np.minimum(rays[..., 1], -1e-6)
    hit = view.position + rays * ((height - view.position[1]) / fall)[..., None]
    near = np.linalg.norm(hit - rig.center, axis=-1) < VICINITY * rig.radius
    return near & (rays[..., 1] < -1e-3)


def _depths(view: View, rig: Rig) -> tuple[float, float]:
    """Nearest and farthest depth of the object's sphere, kept before the camera."""
    middle = float(view.project(rig.center)[1])
    nearest = max(middle - 1.1 * rig.radius, 0.1 * middle, 0.05 * rig.radius)
    return nearest, middle + 1.1 * rig.radius


def _cost_behind(matcher: Matcher, view: View, rig: Rig) -> np.ndarray:
    """Least cost (h, w) over depths from behind the object's sphere to infinity, in the sweep's
    steps.
    """
    first, last = _depths(view, rig)
    step = (1 / first - 1 / last) / (LEVELS - 1)
    inverse_depths = np.arange(1 / last - step, 0, -step)[:LEVELS]
    out = np.full(matcher.lab.shape[:2], UNMATCHED, np.float32)
    for inverse_depth in inverse_depths:
        np.minimum(out, matcher.cost(np.array([0, 0, 1.0]), 1 / inverse_depth), out=out)
    return out


def _least_cost_above(matcher: Matcher, view: View, rig: Rig, height: float) -> np.ndarray:
    """Least cost (h, w) over depths at which the ray is in the object's sphere and above ground."""
    rays = _rays(matcher, view)
    origin = view.position - rig.center
    a = (rays**2).sum(-1)
    b = rays @ origin
    c = float(origin @ origin) - (1.1 * rig.radius) ** 2
    root = np.sqrt(np.maximum(b**2 - a * c, 0))
    near = (-b - root) / a
    far = (-b + root) / a
    far[b**2 <= a * c] = -1  # the ray misses the sphere
    floor = height + ABOVE * rig.radius

    first, last = _depths(view, rig)
    out = np.full(a.shape, np.inf, np.float32)
    for inverse_depth in np.linspace(1 / last, 1 / first, LEVELS):
        z = 1 / inverse_depth
        cost = matcher.cost(np.array([0, 0, 1.0]), z)
        candidate = (z >= near) & (z <= far) & (view.position[1] + z * rays[..., 1] > floor)
        out = np.where(candidate, np.minimum(out, cost), out)
    return out
