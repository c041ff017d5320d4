"""Depth maps of all photos: PatchMatch from coarse to fine between the hull's near and far side,
kept where photos agree.

The cost is bounded whatever share of the frame the object fills: photos are scaled until the
object covers a given number of pixels over all of them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numba
import numpy as np

from pipeline.base.progress import progress
from pipeline.geometry.cameras import View
from pipeline.geometry.mesh_io import Mesh
from pipeline.surface.patch_match import Others, count_agreeing, sweep
from pipeline.surface.preview import caster

OTHERS = 5  # photos that a photo is compared with
CHECKED = 8  # photos whose depth must agree
MIN_AGREEING = 2  # of them
AGREE = 0.01  # depths agree within this share of the object's radius
COARSE = 0.5  # scale of the first round
COARSE_TURNS = 4
FINE_ROUNDS = 2  # each with the geometric consistency of the one before
TRIES = 4  # random changes of a plane per turn
SMALLEST_SIDE = 48  # pixels: a photo is not made smaller than this
PLAUSIBLE = 0.6  # cost above which a plane is not believed: 1 - ZNCC + geometric
SAME_NORMAL = 0.7  # cosine between the normals of photos that agree


@dataclass
class Depth:
    """One photo's depth along the optical axis (h, w), 0 where unknown; unit normals (h, w, 3) in
    the camera's frame; and how many other photos agree (h, w).
    """

    view: View
    depth: np.ndarray
    normal: np.ndarray
    agreeing: np.ndarray


def neighbours(
    views: list[View], center: np.ndarray, count: int, wish: float = 13.0
) -> list[list[int]]:
    """For each view the `count` others whose direction differs by about `wish` degrees (4-40)."""
    d = np.stack([v.position - center for v in views])
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    angle = np.degrees(np.arccos(np.clip(d @ d.T, -1, 1)))
    cost = np.where(
        (angle < 4) | (angle > 40), np.inf, np.abs(np.log(np.maximum(angle, 1e-3) / wish))
    )
    return [[int(j) for j in np.argsort(row)[:count] if np.isfinite(row[j])] for row in cost]


def scale_for(views: list[View], covered: list[float], budget: int) -> float:
    """The scale at which the pixels `covered` (at full size, one number a view) sum to `budget`,
    at most 1.
    """
    side = min(min(v.width, v.height) for v in views)
    scale = min(1.0, float(np.sqrt(budget / max(sum(covered), 1.0))))
    return max(scale, min(1.0, SMALLEST_SIDE / side))


class HullRange:
    """Between which depths the object can lie, by the near and far side of its hull.

    The far side reaches to the ground where there is a plane under the object (`ground`, its
    height), else half the hull's radius further: a hull that holds air must be seen through.
    """

    def __init__(self, hull: Mesh, margin: float, ground: float | None = None):
        self.scene, self.o3d = caster(hull)
        self.margin = margin
        self.ground = ground
        self.low = hull.vertices.min(0)
        self.high = hull.vertices.max(0)

    def _cast(self, origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
        rays = np.concatenate([origins, directions], -1).astype(np.float32)
        return self.scene.cast_rays(self.o3d.core.Tensor(rays))["t_hit"].numpy()

    def __call__(self, view: View) -> tuple[np.ndarray, np.ndarray]:
        """Nearest and farthest depth (h, w) float32 along the optical axis; 0 beside the hull."""
        o, d = view.rays(view.pixel_centers())
        beyond = 2 * float(
            np.linalg.norm(view.position - 0.5 * (self.low + self.high))
            + np.linalg.norm(self.high - self.low)
        )
        enter = self._cast(o, d)
        leave = beyond - self._cast(o + beyond * d, -d)

        hit = np.isfinite(enter) & np.isfinite(leave)
        along = d @ view.world_to_camera[2, :3]
        near = np.where(hit, np.where(hit, enter, 1) * along - self.margin, 0)
        leave = np.maximum(leave, self._behind(o, d, leave))
        far = np.where(hit, np.where(hit, leave, 1) * along + self.margin, 0)
        near = np.where(hit, np.maximum(near, 0.05 * far), 0)
        return near.astype(np.float32), far.astype(np.float32)

    def _behind(self, o: np.ndarray, d: np.ndarray, leave: np.ndarray) -> np.ndarray:
        """How far along each ray (h, w) a surface may lie that shows through the hull."""
        diagonal = float(np.linalg.norm(self.high - self.low))
        if self.ground is None:
            return leave + 0.25 * diagonal
        falling = d[..., 1] < -0.05
        reach = np.where(falling, (self.ground - o[..., 1]) / np.where(falling, d[..., 1], 1), 0)
        return np.minimum(reach, leave + diagonal)


class Planes(NamedTuple):
    """A photo's planes: depth (h, w), 0 where there is none; unit normals (h, w, 3) in the camera's
    frame; cost (h, w). float32.
    """

    depth: np.ndarray
    normal: np.ndarray
    cost: np.ndarray


@dataclass
class Photos:
    """Photos padded to one size. images: (views, h, w) grey; cameras: (views, 6) fx, fy, cx, cy,
    width, height; float32.
    """

    views: list[View]
    images: np.ndarray
    cameras: np.ndarray

    @classmethod
    def at(cls, views: list[View], images: list[np.ndarray]) -> Photos:
        """The images resized to their views' size."""
        cameras = [[v.fx, v.fy, v.cx, v.cy, v.width, v.height] for v in views]
        sides = max(v.height for v in views), max(v.width for v in views)
        stack = np.zeros((len(views), *sides), np.float32)
        for k, (view, image) in enumerate(zip(views, images)):
            size = (view.width, view.height)
            stack[k, : view.height, : view.width] = cv2.resize(
                image, size, interpolation=cv2.INTER_AREA
            )
        return cls(views, stack, np.array(cameras, np.float32))

    def padded(self, maps: list[np.ndarray]) -> np.ndarray:
        """One map per view (h, w, ...) as one array (views, h, w, ...), zero beside each."""
        out = np.zeros(self.images.shape + maps[0].shape[2:], np.float32)
        for k, values in enumerate(maps):
            out[k, : values.shape[0], : values.shape[1]] = values
        return out

    def others(self, k: int, which: list[int], depths: np.ndarray | None) -> Others:
        """The views `which` as seen from view k; with their depth maps where these are known."""
        own = self.views[k].world_to_camera
        rotations = np.stack([self.views[j].world_to_camera[:3, :3] @ own[:3, :3].T for j in which])
        shifts = np.stack([self.views[j].world_to_camera[:3, 3] for j in which])
        shifts = shifts - rotations @ own[:3, 3]
        return Others(
            np.array(which),
            self.images,
            self.images if depths is None else depths,
            rotations.astype(np.float32),
            shifts.astype(np.float32),
            self.cameras[which],
            depths is not None,
        )


def random_planes(
    view: View, near: np.ndarray, far: np.ndarray, rng: np.random.Generator
) -> Planes:
    """Planes to start from: depths more often near the hull's near side, normals that face the
    camera.
    """
    depth = near + (far - near) * rng.random(near.shape) ** 2
    u, v = np.moveaxis(view.pixel_centers(), -1, 0)
    q = np.stack([(u - view.cx) / view.fx, (v - view.cy) / view.fy, np.ones_like(u)], -1)
    to_camera = -q / np.linalg.norm(q, axis=-1, keepdims=True)
    normal = rng.normal(size=q.shape)
    normal *= np.sign((normal * to_camera).sum(-1, keepdims=True))
    normal = normal / np.linalg.norm(normal, axis=-1, keepdims=True) + 1.2 * to_camera
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    unknown = np.full(near.shape, 2.0)
    return Planes(*(a.astype(np.float32) for a in (depth, normal, unknown)))


def enlarged(planes: Planes, view: View) -> Planes:
    """The planes of a smaller photo as a start for a larger one."""
    size = (view.width, view.height)
    double = lambda a: cv2.resize(a, size, interpolation=cv2.INTER_NEAREST)
    return Planes(*(double(a) for a in planes))


def improved(
    photos: Photos,
    k: int,
    which: list[int],
    between: tuple[np.ndarray, np.ndarray],
    start: Planes,
    depths: np.ndarray | None,
    turns: int,
    spread: float,
    seed: int,
) -> Planes:
    """The planes of view k after `turns` of both colours of the checkerboard.

    between: nearest and farthest depth (h, w); spread: width of the random changes as a share of
    that range, which shrinks from turn to turn; depths: of all views, for geometric consistency.
    """
    near, far = between
    view = photos.views[k]
    depth = np.clip(start.depth, near, far)
    normal = start.normal.copy()
    cost = start.cost.copy()
    others = photos.others(k, which, depths)
    image = np.ascontiguousarray(photos.images[k, : view.height, : view.width])
    rows = dealt_out(np.flatnonzero((far > 0).any(1)), numba.get_num_threads())
    for turn in range(turns):
        for color in (0, 1):
            width = np.float32(spread * 0.6**turn)
            draw = (seed * 1000 + k) * 100 + 2 * turn + color
            fresh = turn == 0
            sweep(
                image, photos.cameras[k], others, near, far, depth, normal, cost,
                rows, color, fresh, width, TRIES, draw,
            )  # fmt: skip
    return Planes(depth, normal, cost)


def dealt_out(rows: np.ndarray, hands: int) -> np.ndarray:
    """The rows as threads take them that get as many neighbouring places each: one by one in turn,
    for an object is wider in the middle than above and below.
    """
    return np.concatenate([rows[k::hands] for k in range(hands)])


def depth_maps(
    views: list[View],
    images: list[np.ndarray],
    hull: Mesh,
    margin: float,
    budget: int,
    threads: int,
    ground: float | None = None,
    seed: int = 0,
) -> tuple[list[Depth], float]:
    """Depth maps of all views that photos agree on, and the share of the hull's pixels that have
    one.

    images: grey (h, w) in [0, 1], any scale of the views; hull: closed surface around the object,
    right to within `margin`; budget: object pixels over all photos that
    is never exceeded; ground: height of the plane that the object stands on, if any.
    """
    numba.set_num_threads(min(threads, numba.get_num_threads()))
    between = HullRange(hull, margin, ground)
    covered = [16.0 * float((between(v.scaled(0.25))[1] > 0).sum()) for v in views]
    scale = scale_for(views, covered, budget)
    center = 0.5 * (between.low + between.high)
    radius = 0.5 * float(np.linalg.norm(between.high - between.low))
    partners = neighbours(views, center, OTHERS)

    rng = np.random.default_rng(seed)
    small = Photos.at([v.scaled(COARSE * scale) for v in views], images)
    planes = []
    for k, view in enumerate(progress(small.views, "depth, coarse", len(views))):
        reach = between(view)
        start = random_planes(view, *reach, rng)
        planes.append(
            improved(small, k, partners[k], reach, start, None, COARSE_TURNS, 0.5, seed)
            if partners[k]
            else start
        )

    large = Photos.at([v.scaled(scale) for v in views], images)
    starts = [enlarged(p, v) for p, v in zip(planes, large.views)]
    reaches = [between(v) for v in large.views]
    for turn in range(FINE_ROUNDS):
        depths = large.padded([p.depth for p in starts])
        for k, reach in enumerate(progress(reaches, f"depth, fine {turn + 1}", len(views))):
            if partners[k]:
                starts[k] = improved(
                    large, k, partners[k], reach, starts[k], depths, 1, 0.02, seed + turn
                )
    return consistent(large, starts, neighbours(views, center, CHECKED), AGREE * radius)


def consistent(
    photos: Photos, planes: list[Planes], near: list[list[int]], tolerance: float
) -> tuple[list[Depth], float]:
    """Depths that at least MIN_AGREEING of the `near` photos agree with, and their share of all."""
    believed = photos.padded([np.where(p.cost < PLAUSIBLE, p.depth, 0) for p in planes])
    normals = photos.padded([p.normal for p in planes])
    out = []
    known = 0
    total = 0
    for k, (view, p) in enumerate(zip(photos.views, planes)):
        count = np.zeros(p.depth.shape, np.float32)
        if near[k]:
            own = np.ascontiguousarray(believed[k, : view.height, : view.width])
            others = photos.others(k, near[k], believed)
            count = count_agreeing(
                photos.cameras[k], others, own, p.normal, normals, tolerance, SAME_NORMAL
            )
        good = count >= MIN_AGREEING
        known += int(good.sum())
        total += int((p.depth > 0).sum())
        kept = np.where(good, p.depth, 0).astype(np.float32)
        out.append(Depth(view, kept, p.normal, np.where(good, count, 0).astype(np.float32)))
    return out, known / max(total, 1)
