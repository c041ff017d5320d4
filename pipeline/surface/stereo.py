"""Depth maps by semi-global matching on rectified pairs (Hirschmueller 2008, OpenCV), kept where
views agree.

Rectification (Fusiello et al. 2000): both cameras are turned so that x runs along the baseline;
this takes care of any roll between them. The right principal point is shifted by the smallest
disparity, because OpenCV 5 fails on large ones.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import cv2
import numpy as np

from pipeline.base.progress import progress
from pipeline.geometry.cameras import View

MIN_AGREEING = 2
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


def rectified_pair(a: View, b: View, hull: np.ndarray, margin: float):
    """Rotation (3, 3), focal length, picture size, principal points of left and right, smallest and
    number of disparities.

    The picture and the disparities reach just as far as the points `hull` (n, 3) and `margin`
    around them: a close-up whose search went as far as a sphere around the object took a hundred
    times as long.
    """
    x = b.position - a.position
    baseline = np.linalg.norm(x)
    x = x / baseline
    z = a.world_to_camera[2, :3] + b.world_to_camera[2, :3]
    z = z - (z @ x) * x
    z /= np.linalg.norm(z)
    rotation = np.stack([x, np.cross(z, x), z])
    focal = 0.5 * (a.fx + b.fx)
    p = (hull - a.position) @ rotation.T
    near = max(p[:, 2].min() - margin, 0.2 * np.median(p[:, 2]))
    d_min, d_max = focal * baseline / (p[:, 2].max() + margin), focal * baseline / near
    count = int(np.ceil((d_max - d_min) / 16)) * 16
    at, edge = focal * p[:, :2] / np.maximum(p[:, 2:], near), focal * margin / near + 4
    low, high = at.min(0) - edge, at.max(0) + edge
    width, height = int(high[0] - low[0]) + count, int(high[1] - low[1])
    return rotation, focal, baseline, (width, height), (count - low[0], -low[1]), d_min, count


def pair_depth(a: View, b: View, image_a, image_b, hull, margin: float) -> np.ndarray:
    """Depth of view a (h, w) from its pair with b; 0 where matching failed. Images are 8-bit grey
    at the views' size.
    """
    rotation, focal, baseline, size, (cx, cy), d_min, count = rectified_pair(a, b, hull, margin)
    K = np.array([[focal, 0, cx], [0, focal, cy], [0, 0, 1.0]])
    Kb = K + [[0, 0, d_min], [0, 0, 0], [0, 0, 0]]
    shift = np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1]])  # OpenCV's pixel centres are integers
    back = np.linalg.inv(shift)
    Ha = K @ rotation @ a.world_to_camera[:3, :3].T @ np.linalg.inv(a.K)
    Hb = Kb @ rotation @ b.world_to_camera[:3, :3].T @ np.linalg.inv(b.K)
    left = cv2.warpPerspective(image_a, back @ Ha @ shift, size, flags=cv2.INTER_LINEAR)
    right = cv2.warpPerspective(image_b, back @ Hb @ shift, size, flags=cv2.INTER_LINEAR)
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
    disparity = matcher.compute(left, right).astype(np.float32) / 16
    u, v = np.meshgrid(np.arange(a.width) + 0.5, np.arange(a.height) + 0.5)
    p = np.stack([u, v, np.ones_like(u)], -1) @ Ha.T
    x, y = (p[..., 0] / p[..., 2]), (p[..., 1] / p[..., 2])
    d = cv2.remap(
        disparity,
        (x - 0.5).astype(np.float32),
        (y - 0.5).astype(np.float32),
        cv2.INTER_NEAREST,
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=-1,
    )
    z = focal * baseline / (np.maximum(d, 0) + d_min)  # depth in the rectified frame
    ray = np.stack([(x - cx) / focal, (y - cy) / focal, np.ones_like(x)], -1) @ rotation
    depth = z * (ray @ a.world_to_camera[2, :3])
    return np.where(d > 0, depth, 0).astype(np.float32)


def merge_pairs(depths: list[np.ndarray], tolerance: float) -> np.ndarray:
    """Per pixel the median of the pairs' depths; a lone depth stays, pairs further apart than
    `tolerance` are dropped.
    """
    stack = np.sort(np.where(np.stack(depths) > 0, np.stack(depths), np.inf), axis=0)
    count = np.isfinite(stack).sum(0)
    middle = np.take_along_axis(stack, np.maximum(count - 1, 0)[None] // 2, 0)[0]
    with np.errstate(invalid="ignore"):
        near = (np.abs(stack - middle) < tolerance).sum(0)
    return np.where((count > 0) & (2 * near >= count), middle, 0).astype(np.float32)


def cross_check(
    depths: list[np.ndarray], views: list[View], near: list[list[int]], tolerance: float
) -> list[np.ndarray]:
    """How many of each view's neighbours see the same surface point within `tolerance` in depth (h,
    w).
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
                at, depth = views[j].project(points)
                u, v = np.floor(at[:, 0]).astype(int), np.floor(at[:, 1]).astype(int)
                ok = (
                    (depth > 0) & (u >= 0) & (v >= 0) & (u < views[j].width) & (v < views[j].height)
                )
                other = np.zeros(len(points), np.float32)
                other[ok] = depths[j][v[ok], u[ok]]
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
    low, high = hull.min(0) - margin, hull.max(0) + margin
    center, radius = 0.5 * (low + high), 0.5 * float(np.linalg.norm(high - low))
    partners = neighbours(views, center, 3)

    def one(k: int) -> np.ndarray:
        pairs = [
            pair_depth(views[k], views[j], images[k], images[j], hull, margin) for j in partners[k]
        ]
        return (
            np.where(masks[k], merge_pairs(pairs, AGREE * radius), 0)
            if pairs
            else np.zeros(masks[k].shape, np.float32)
        )

    with ThreadPoolExecutor(threads) as pool:
        depths = list(progress(pool.map(one, range(len(views))), "stereo", len(views)))
    agreeing = cross_check(depths, views, neighbours(views, center, 8), AGREE * radius)
    out, known, total = [], 0, 0
    for view, depth, count, mask in zip(views, depths, agreeing, masks):
        good = (count >= MIN_AGREEING) & (depth > 0)
        dense = cv2.blur(good.astype(np.float32), (21, 21)) >= 0.4 * cv2.blur(
            mask.astype(np.float32), (21, 21)
        )
        good &= dense  # lone islands are mostly wrong
        known, total = known + good.sum(), total + mask.sum()
        out.append(
            Depth(
                view,
                np.where(good, depth, 0).astype(np.float32),
                np.where(good, count, 0).astype(np.float32),
            )
        )
    return out, float(known / max(total, 1))
