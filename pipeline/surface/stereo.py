"""Depth maps by semi-global matching on rectified pairs (Hirschmueller 2008, OpenCV), kept where
views agree.

Rectification (Fusiello et al. 2000): both cameras are turned so that x runs along the baseline;
this takes care of any roll between them. The right principal point is shifted by the smallest
disparity, because OpenCV 5 fails on large ones.

Letters: K intrinsics (3, 3); u, v pixel coordinates; x, y, z in the rectified frame, or on its
picture; d disparity in pixels; o, d of rays as in `geometry.cameras`.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import cv2
import numpy as np

from pipeline.base.progress import progress
from pipeline.geometry.cameras import View

MIN_AGREEING = 2  # views
AGREE = 0.03  # depths agree within this share of the object's radius, whatever its distance


@dataclass
class Depth:
    """Depth along the optical axis (h, w), 0 where unknown, and how many views agree (h, w)."""

    view: View
    depth: np.ndarray
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


@dataclass
class Rectified:
    """A pair of views turned so that x runs along their baseline.

    rotation: (3, 3) from the world; focal: pixels; baseline: distance of the cameras; size: (width,
    height) of both pictures; cx, cy: left principal point; disparity: smallest one in pixels, by
    which the right principal point is shifted; count: how many disparities are searched.
    """

    rotation: np.ndarray
    focal: float
    baseline: float
    size: tuple[int, int]
    cx: float
    cy: float
    disparity: float
    count: int

    def homographies(self, a: View, b: View) -> tuple[np.ndarray, np.ndarray]:
        """From pixels of a to the left picture, and of b to the right one; (3, 3) each."""
        K_left = np.array([[self.focal, 0, self.cx], [0, self.focal, self.cy], [0, 0, 1.0]])
        K_right = K_left + [[0, 0, self.disparity], [0, 0, 0], [0, 0, 0]]
        turned = lambda K, view: K @ self.rotation @ view.world_to_camera[:3, :3].T
        left = turned(K_left, a) @ np.linalg.inv(a.K)
        right = turned(K_right, b) @ np.linalg.inv(b.K)
        return left, right


def rectified_pair(a: View, b: View, hull: np.ndarray, margin: float) -> Rectified:
    """The rectification of two views of the points `hull` (n, 3).

    The pictures and the disparities reach just as far as these points and `margin` around them: a
    close-up whose search went as far as a sphere around the object took a hundred times as long.
    """
    x = b.position - a.position
    baseline = np.linalg.norm(x)
    x = x / baseline
    z = a.world_to_camera[2, :3] + b.world_to_camera[2, :3]
    z = z - (z @ x) * x
    z /= np.linalg.norm(z)
    rotation = np.stack([x, np.cross(z, x), z])

    focal = 0.5 * (a.fx + b.fx)
    points = (hull - a.position) @ rotation.T
    depth = points[:, 2]
    nearest = max(depth.min() - margin, 0.2 * np.median(depth))
    smallest = focal * baseline / (depth.max() + margin)
    largest = focal * baseline / nearest
    count = int(np.ceil((largest - smallest) / 16)) * 16

    at = focal * points[:, :2] / np.maximum(points[:, 2:], nearest)
    edge = focal * margin / nearest + 4
    low = at.min(0) - edge
    high = at.max(0) + edge
    size = (int(high[0] - low[0]) + count, int(high[1] - low[1]))
    return Rectified(rotation, focal, baseline, size, count - low[0], -low[1], smallest, count)


def _matched(left: np.ndarray, right: np.ndarray, count: int) -> np.ndarray:
    """Disparities (h, w) in pixels of rectified 8-bit pictures; 0 or less where matching failed."""
    matcher = cv2.StereoSGBM_create(
        minDisparity=0,
        numDisparities=count,
        blockSize=5,
        P1=200,
        P2=800,
        disp12MaxDiff=1,
        uniquenessRatio=5,
        speckleWindowSize=80,
        speckleRange=2,
        mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY,
    )
    return matcher.compute(left, right).astype(np.float32) / 16


def pair_depth(a: View, b: View, image_a, image_b, hull, margin: float) -> np.ndarray:
    """Depth of view a (h, w) from its pair with b; 0 where matching failed. Images are 8-bit grey
    at the views' size.
    """
    pair = rectified_pair(a, b, hull, margin)
    to_left, to_right = pair.homographies(a, b)
    shift = np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1]])  # OpenCV's pixel centres are integers
    back = np.linalg.inv(shift)
    warp = lambda image, H: cv2.warpPerspective(
        image, back @ H @ shift, pair.size, flags=cv2.INTER_LINEAR
    )
    disparity = _matched(warp(image_a, to_left), warp(image_b, to_right), pair.count)

    # back to the pixels of view a
    u, v = np.meshgrid(np.arange(a.width) + 0.5, np.arange(a.height) + 0.5)
    p = np.stack([u, v, np.ones_like(u)], -1) @ to_left.T
    x = p[..., 0] / p[..., 2]
    y = p[..., 1] / p[..., 2]
    d = cv2.remap(
        disparity,
        (x - 0.5).astype(np.float32),
        (y - 0.5).astype(np.float32),
        cv2.INTER_NEAREST,
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=-1,
    )

    z = pair.focal * pair.baseline / (np.maximum(d, 0) + pair.disparity)
    ray = np.stack([(x - pair.cx) / pair.focal, (y - pair.cy) / pair.focal, np.ones_like(x)], -1)
    depth = z * (ray @ pair.rotation @ a.world_to_camera[2, :3])
    return np.where(d > 0, depth, 0).astype(np.float32)


def merge_pairs(depths: list[np.ndarray], tolerance: float) -> np.ndarray:
    """Per pixel the median of the pairs' depths; a lone depth stays, pairs further apart than
    `tolerance` are dropped.
    """
    stack = np.stack(depths)
    stack = np.sort(np.where(stack > 0, stack, np.inf), axis=0)
    count = np.isfinite(stack).sum(0)
    middle = np.take_along_axis(stack, np.maximum(count - 1, 0)[None] // 2, 0)[0]
    with np.errstate(invalid="ignore"):
        near = (np.abs(stack - middle) < tolerance).sum(0)
    return np.where((count > 0) & (2 * near >= count), middle, 0).astype(np.float32)


def _depths_at(view: View, image: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where points (n, 3) project: the value of the view's depth map `image` (h, w), 0 outside the
    frame, and the points' own depth; (n,) each.
    """
    at, depth = view.project(points)
    u, v = np.floor(at).astype(int).T
    inside = (depth > 0) & (u >= 0) & (v >= 0) & (u < view.width) & (v < view.height)
    out = np.zeros(len(points), np.float32)
    out[inside] = image[v[inside], u[inside]]
    return out, depth


def cross_check(
    depths: list[np.ndarray], views: list[View], near: list[list[int]], tolerance: float
) -> list[np.ndarray]:
    """How many of each view's neighbours see the same surface point within `tolerance` in depth:
    (h, w) per view.
    """
    out = []
    for k, view in enumerate(views):
        count = np.zeros(depths[k].shape, np.float32)
        rows, columns = np.nonzero(depths[k])
        if len(rows):
            uv = np.stack([columns + 0.5, rows + 0.5], -1)
            _, d = view.rays(uv)
            along = depths[k][rows, columns] / (d @ view.world_to_camera[2, :3])
            points = view.position + d * along[:, None]
            for j in near[k]:
                other, depth = _depths_at(views[j], depths[j], points)
                count[rows, columns] += (other > 0) & (np.abs(other - depth) < tolerance)
        out.append(count)
    return out


def stereo(
    views: list[View],
    images: list[np.ndarray],
    masks: list[np.ndarray],
    hull: np.ndarray,
    margin: float,
    threads: int,
) -> tuple[list[Depth], float]:
    """Consistent depth maps of all views, and the share of mask pixels that have one.

    views: scaled to the images' size; images: 8-bit grey; masks: bool at that size; hull: points
    (n, 3) that fill the object's volume to within `margin`.
    """
    low = hull.min(0) - margin
    high = hull.max(0) + margin
    center = 0.5 * (low + high)
    radius = 0.5 * float(np.linalg.norm(high - low))
    partners = neighbours(views, center, 3)

    def one(k: int) -> np.ndarray:
        if not partners[k]:
            return np.zeros(masks[k].shape, np.float32)
        pairs = [
            pair_depth(views[k], views[j], images[k], images[j], hull, margin) for j in partners[k]
        ]
        return np.where(masks[k], merge_pairs(pairs, AGREE * radius), 0)

    with ThreadPoolExecutor(threads) as pool:
        depths = list(progress(pool.map(one, range(len(views))), "stereo", len(views)))
    agreeing = cross_check(depths, views, neighbours(views, center, 8), AGREE * radius)

    out = []
    known = 0
    total = 0
    around = lambda flags: cv2.blur(flags.astype(np.float32), (21, 21))
    for view, depth, count, mask in zip(views, depths, agreeing, masks):
        good = (count >= MIN_AGREEING) & (depth > 0)
        good &= around(good) >= 0.4 * around(mask)  # lone islands are mostly wrong
        known += good.sum()
        total += mask.sum()

        depth = np.where(good, depth, 0).astype(np.float32)
        count = np.where(good, count, 0).astype(np.float32)
        out.append(Depth(view, depth, count))
    return out, float(known / max(total, 1))
