"""Pinhole cameras. Library frame: right-handed, Y-up. Camera axes: OpenCV (x right, y down, z
forward).

Letters: K (3, 3) intrinsics in pixels, pixel centres at +0.5; uv (..., 2) pixel coordinates; o, d
(..., 3) origins and unit directions of rays.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

import numpy as np
from numba import njit

from pipeline.base.errors import InputError
from pipeline.base.files import read_json, write_json

# (x, y, z) -> (x, z, -y)
Y_FROM_Z_UP = np.array([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1.0]])
OPENCV_FROM_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])


def projected(
    xyz: np.ndarray, world_to_camera: np.ndarray, fx: float, fy: float, cx: float, cy: float
) -> tuple[np.ndarray, np.ndarray]:
    """World points (..., 3) -> pixel coordinates (..., 2) of a pinhole camera with pose (4, 4), and
    depth along its optical axis (...).
    """
    xyz = np.asarray(xyz, float)
    points = xyz.reshape(-1, 3)
    uv, depth = np.empty((len(points), 2)), np.empty(len(points))
    matrix = np.ascontiguousarray(world_to_camera, float)
    _projected_into(uv, depth, points, matrix, float(fx), float(fy), float(cx), float(cy))
    return uv.reshape(*xyz.shape[:-1], 2), depth.reshape(xyz.shape[:-1])


@njit(nogil=True, cache=True)
def _projected_into(
    uv: np.ndarray,
    depth: np.ndarray,
    xyz: np.ndarray,
    world_to_camera: np.ndarray,
    fx: float,
    fy: float,
    cx: float,
    cy: float,
) -> None:
    """The loop of `projected` over points (n, 3), a tenth of the time of matrix products in
    NumPy: many points, three numbers each.
    """
    m = world_to_camera
    for k in range(len(xyz)):
        x, y, z = xyz[k]
        forward = m[2, 0] * x + m[2, 1] * y + m[2, 2] * z + m[2, 3]
        divisor = 1e-12 if abs(forward) < 1e-12 else forward
        uv[k, 0] = fx * (m[0, 0] * x + m[0, 1] * y + m[0, 2] * z + m[0, 3]) / divisor + cx
        uv[k, 1] = fy * (m[1, 0] * x + m[1, 1] * y + m[1, 2] * z + m[1, 3]) / divisor + cy
        depth[k] = forward


@dataclass
class View:
    """One undistorted photo: pinhole, no lens distortion left."""

    name: str
    image: str
    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    world_to_camera: np.ndarray
    clip_level: float = 1.0  # linear value at and above which a channel is saturated
    split: str = "fit"  # "fit", or "test" for a view never used for fitting
    saturated: str | None = None  # picture of its saturated pixels; none: by `clip_level`

    @property
    def K(self) -> np.ndarray:
        return np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1.0]])

    @property
    def position(self) -> np.ndarray:
        return -self.world_to_camera[:3, :3].T @ self.world_to_camera[:3, 3]

    def scaled(self, factor: float) -> View:
        """The same view at round(width * factor) pixels; intrinsics follow the exact ratios."""
        return self.at_size(max(1, round(self.width * factor)), max(1, round(self.height * factor)))

    def at_size(self, width: int, height: int) -> View:
        """The same view at `width` x `height` pixels, the whole picture resized to it."""
        ratio_x = width / self.width
        ratio_y = height / self.height
        return replace(
            self,
            width=width,
            height=height,
            fx=self.fx * ratio_x,
            fy=self.fy * ratio_y,
            cx=self.cx * ratio_x,
            cy=self.cy * ratio_y,
        )

    def project(self, xyz: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """World points (..., 3) -> pixel coordinates (..., 2) and depth along the optical axis
        (...).
        """
        return projected(xyz, self.world_to_camera, self.fx, self.fy, self.cx, self.cy)

    def pixel_centers(self) -> np.ndarray:
        """Pixel coordinates (h, w, 2) of the centres of all pixels."""
        u, v = np.meshgrid(np.arange(self.width) + 0.5, np.arange(self.height) + 0.5)
        return np.stack([u, v], -1)

    def rays(self, uv: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Pixel coordinates (..., 2) -> origins and unit directions (..., 3) in the world frame."""
        x = (uv[..., 0] - self.cx) / self.fx
        y = (uv[..., 1] - self.cy) / self.fy
        d = np.stack([x, y, np.ones(uv.shape[:-1])], -1)
        d = (d / np.linalg.norm(d, axis=-1, keepdims=True)) @ self.world_to_camera[:3, :3]
        return np.broadcast_to(self.position, d.shape), d


@dataclass
class Rig:
    """All views of a scene and the sphere the object lies in (library frame)."""

    views: list[View]
    center: np.ndarray
    radius: float
    source: str
    facts: dict = field(default_factory=dict)

    def fit_views(self) -> list[View]:
        """The views that stages may learn from."""
        return [v for v in self.views if v.split == "fit"]

    def test_views(self) -> list[View]:
        """The views that are kept for scoring."""
        return [v for v in self.views if v.split == "test"]

    def training(self) -> Rig:
        """The scene as it is known without the views that are kept for scoring."""
        return replace(self, views=self.fit_views())

    def about(self, center: np.ndarray, radius: float) -> Rig:
        """The scene with another sphere that the object lies in: centre (3,) and radius."""
        return replace(self, center=np.asarray(center, float), radius=float(radius))

    def holding(self, points: np.ndarray) -> Rig:
        """The scene with a sphere that holds points (n, 3): its own where it does, else the one
        about the middle of their box.
        """
        if (np.linalg.norm(points - self.center, axis=1) <= self.radius).all():
            return self
        center = 0.5 * (points.min(0) + points.max(0))
        return self.about(center, np.linalg.norm(points - center, axis=1).max())


def save_cameras(path: str | Path, rig: Rig) -> None:
    """Write cameras.json."""
    write_json(
        path,
        {
            "frame": "y-up opencv world_to_camera",
            "source": rig.source,
            "object": {"center": np.asarray(rig.center), "radius": float(rig.radius)},
            "facts": rig.facts,
            "views": [asdict(v) for v in rig.views],
        },
    )


def load_cameras(path: str | Path) -> Rig:
    """Read cameras.json written by `save_cameras`."""
    data = read_json(path)
    try:
        views = [
            View(**{**v, "world_to_camera": np.array(v["world_to_camera"], float)})
            for v in data["views"]
        ]
        sphere = data["object"]
        return Rig(
            views,
            np.array(sphere["center"], float),
            float(sphere["radius"]),
            data["source"],
            data.get("facts", {}),
        )
    except (KeyError, TypeError) as error:
        raise InputError(
            f"not a cameras.json of this version ({error!r})",
            path,
            "delete the file and run the poses stage again",
        ) from error
