"""Known cameras: transforms.json (NeRF-synthetic, instant-ngp, nerfstudio) and COLMAP models, as
`Lens` + pose.

Poses are world-to-camera with OpenCV axes. transforms.json is Z-up by convention and turned to Y-up
here.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.base.errors import InputError
from pipeline.geometry.cameras import OPENCV_FROM_OPENGL, Y_FROM_Z_UP
from pipeline.photos.scene_files import path_in_scene, photo_name

if TYPE_CHECKING:
    import pycolmap


@dataclass
class Lens:
    """Intrinsics with OpenCV distortion (k1, k2, p1, p2), pixel centres at +0.5, at size (width,
    height).
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple = (0.0, 0.0, 0.0, 0.0)

    def turned_right(self) -> Lens:
        """The lens of the same photo turned by a quarter clockwise."""
        k1, k2, p1, p2 = self.distortion
        return Lens(
            self.height,
            self.width,
            self.fy,
            self.fx,
            self.height - self.cy,
            self.cx,
            (k1, k2, p2, -p1),
        )

    def at(self, width: int, height: int) -> Lens:
        """The same lens for a resized photo."""
        ratio_x = width / self.width
        ratio_y = height / self.height
        return Lens(
            width,
            height,
            self.fx * ratio_x,
            self.fy * ratio_y,
            self.cx * ratio_x,
            self.cy * ratio_y,
            self.distortion,
        )


def check_shape(w: float, h: float, size: tuple[int, int], where: str | Path, name: str) -> None:
    """InputError when a camera's picture and its photo differ in shape by more than rounding
    (turned or cropped photo).
    """
    if abs(w * size[1] - h * size[0]) > 1.5 * max(w, h, *size):
        raise InputError(
            f"the camera of '{name}' is {w:g}x{h:g}, the photo {size[0]}x{size[1]}: "
            "not the same shape",
            where,
            "use the very photos the cameras were made from (same crop, same EXIF rotation)",
        )


def _transforms_lens(data: dict, frame: dict, size: tuple[int, int], file: Path) -> Lens:
    value: Callable[..., Any] = lambda key, default=None: frame.get(key, data.get(key, default))
    extra = [k for k in ("k3", "k4", "k5", "k6") if value(k)]
    if extra or "FISHEYE" in str(value("camera_model", "")).upper():
        raise InputError(
            f"lens model {value('camera_model', '')} with {extra or 'fisheye'} distortion "
            "is not supported",
            file,
            "undistort the photos first, or export with k1, k2, p1, p2 only",
        )

    w = value("w", size[0])
    h = value("h", size[1])
    check_shape(w, h, size, file, frame["file_path"])

    if value("fl_x"):
        fx = float(value("fl_x"))
    elif value("camera_angle_x"):
        fx = 0.5 * w / np.tan(0.5 * float(value("camera_angle_x")))
    else:
        raise InputError("neither fl_x nor camera_angle_x is given", file, "add the focal length")

    return Lens(
        int(w),
        int(h),
        fx,
        float(value("fl_y", fx)),
        float(value("cx", w / 2)),
        float(value("cy", h / 2)),
        tuple(float(value(k, 0.0)) for k in ("k1", "k2", "p1", "p2")),
    )


def read_transforms(
    file: Path, scene: Path, sizes: dict[str, tuple[int, int]]
) -> dict[str, tuple[Lens, np.ndarray]]:
    """name -> (Lens, world-to-camera in the Y-up frame). `sizes`: each photo's original (width,
    height).
    """
    data = json.loads(file.read_text(encoding="utf-8"))
    out = {}
    for frame in data["frames"]:
        name = photo_name(scene, path_in_scene(scene, frame["file_path"], file))
        matrix = np.array(frame.get("transform_matrix"), float)
        if matrix.shape != (4, 4) or not np.isfinite(matrix).all():
            raise InputError(
                f"frame '{frame['file_path']}' has no 4x4 transform_matrix",
                file,
                "export the cameras again",
            )
        lens = _transforms_lens(data, frame, sizes[name], file)
        out[name] = (lens, np.linalg.inv(Y_FROM_Z_UP @ matrix @ OPENCV_FROM_OPENGL))
    return out


# Camera axes of a photo (x right, y down) after it was turned by a quarter clockwise
TURNED_RIGHT = np.array([[0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]])


def turned_right(lens: Lens, pose: np.ndarray) -> tuple[Lens, np.ndarray]:
    """Lens and world-to-camera (4, 4) of a photo after it was turned by a quarter clockwise."""
    return lens.turned_right(), TURNED_RIGHT @ pose


# COLMAP camera model -> places of fx, fy, cx, cy and of the distortion among its parameters
PARAMETERS = {
    "SIMPLE_PINHOLE": (0, 0, 1, 2, ()),
    "PINHOLE": (0, 1, 2, 3, ()),
    "SIMPLE_RADIAL": (0, 0, 1, 2, (3,)),
    "RADIAL": (0, 0, 1, 2, (3, 4)),
    "OPENCV": (0, 1, 2, 3, (4, 5, 6, 7)),
}


def lens_of_colmap(camera: pycolmap.Camera) -> Lens:
    """A pycolmap camera as Lens; InputError for models with more than OPENCV's distortion."""
    params = list(camera.params)
    name = camera.model.name
    if name not in PARAMETERS:
        raise InputError(
            f"camera model {name} is not supported",
            "sparse/0",
            "convert the model to PINHOLE, SIMPLE_RADIAL, RADIAL or OPENCV",
        )
    *pinhole, rest = PARAMETERS[name]
    fx, fy, cx, cy = (params[k] for k in pinhole)
    distortion = tuple(params[k] for k in rest)
    distortion += (0.0,) * (4 - len(distortion))
    return Lens(camera.width, camera.height, fx, fy, cx, cy, distortion)


def poses_of_model(
    model: pycolmap.Reconstruction, names: dict[str, str]
) -> dict[str, tuple[Lens, np.ndarray]]:
    """Registered images of a pycolmap Reconstruction: photo name -> (Lens, world-to-camera).
    `names`: the model's image name -> photo name; other images are left out.
    """
    out = {}
    for image in model.images.values():
        if image.has_pose and image.name in names:
            pose = np.eye(4)
            pose[:3] = image.cam_from_world().matrix()
            out[names[image.name]] = (lens_of_colmap(model.cameras[image.camera_id]), pose)
    return out
