"""Known cameras: transforms.json (NeRF-synthetic, instant-ngp, nerfstudio) and COLMAP models, as
`Lens` + pose.

Poses are world-to-camera with OpenCV axes. transforms.json is Z-up by convention and turned to Y-up
here.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial.transform import Rotation

from pipeline.base.errors import InputError
from pipeline.geometry.cameras import OPENCV_FROM_OPENGL, Y_FROM_Z_UP
from pipeline.photos.scene_files import path_in_scene, photo_name
from pipeline.photos.transforms_file import Frame, Transforms, read_transforms_file

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


MOST_DISTORTED = 10.0  # k1 ... p2 of no lens are beyond it
FARTHEST_CENTRE = 1.0  # of the picture's size: how far outside a principal point may lie
FLAT = ("", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "PERSPECTIVE")


def _transforms_lens(data: Transforms, frame: Frame, size: tuple[int, int], file: Path) -> Lens:
    def value(key: str, default: Any = None) -> Any:
        own, common = getattr(frame, key), getattr(data, key)
        return own if own is not None else common if common is not None else default

    extra = [k for k in ("k3", "k4", "k5", "k6") if value(k)]
    model = frame.camera_model or data.camera_model
    fisheye = frame.is_fisheye or data.is_fisheye
    if extra or fisheye or model.upper() not in FLAT:
        raise InputError(
            f"lens model {model} with {extra or 'fisheye or other'} distortion is not supported",
            file,
            "undistort the photos first, or export with k1, k2, p1, p2 only",
        )

    w = value("w", size[0])
    h = value("h", size[1])
    check_shape(w, h, size, file, frame.file_path)

    if value("fl_x"):
        fx = value("fl_x")
    elif value("camera_angle_x"):
        fx = 0.5 * w / np.tan(0.5 * value("camera_angle_x"))
    else:
        raise InputError("neither fl_x nor camera_angle_x is given", file, "add the focal length")

    distortion = tuple(value(k, 0.0) for k in ("k1", "k2", "p1", "p2"))
    lens = Lens(
        int(w), int(h), fx, value("fl_y", fx), value("cx", w / 2), value("cy", h / 2), distortion
    )
    check_lens(lens, file)
    return lens


def check_lens(lens: Lens, where: str | Path) -> None:
    """InputError for numbers that no lens has."""
    for name, length in (("fx", lens.fx), ("fy", lens.fy)):
        if not (np.isfinite(length) and length > 0):
            raise InputError(
                f"the focal length {name} is {length:g}", where, "export the cameras again"
            )
    for name, at, size in (("cx", lens.cx, lens.width), ("cy", lens.cy, lens.height)):
        if not -FARTHEST_CENTRE * size < at < (1 + FARTHEST_CENTRE) * size:
            raise InputError(
                f"the principal point {name} is {at:g}, of {size} pixels",
                where,
                "give it in pixels of the photo, or leave it out for the middle",
            )
    if not max(abs(k) for k in lens.distortion) <= MOST_DISTORTED:
        raise InputError(
            f"the distortion k1, k2, p1, p2 is {', '.join(f'{k:g}' for k in lens.distortion)}",
            where,
            "export the cameras again, or undistort the photos",
        )


def read_transforms(
    file: Path, scene: Path, sizes: dict[str, tuple[int, int]]
) -> dict[str, tuple[Lens, np.ndarray]]:
    """name -> (Lens, world-to-camera in the Y-up frame). `sizes`: each captured photo's original
    (width, height). Raises InputError for a frame whose photo was not captured.
    """
    data = read_transforms_file(file)
    out = {}
    for frame in data.frames:
        name = photo_name(scene, path_in_scene(scene, frame.file_path, file))
        if name not in sizes:
            raise InputError(
                f"the photo of frame '{frame.file_path}' was not captured",
                file,
                "run the capture stage again: it was run before these cameras were given",
            )
        lens = _transforms_lens(data, frame, sizes[name], file)
        pose = Y_FROM_Z_UP @ frame.camera_to_world(file) @ OPENCV_FROM_OPENGL
        out[name] = (lens, np.linalg.inv(pose))

    if (
        len(out) > 1
        and np.ptp([np.linalg.inv(pose)[:3, 3] for _, pose in out.values()], 0).max() == 0
    ):
        raise InputError(
            "all cameras stand in one place", file, "export the cameras again, with their positions"
        )
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
    lens = Lens(camera.width, camera.height, fx, fy, cx, cy, distortion)
    check_lens(lens, "sparse/0")
    return lens


def poses_of_model(
    model: pycolmap.Reconstruction, names: dict[str, str]
) -> dict[str, tuple[Lens, np.ndarray]]:
    """Registered images of a pycolmap Reconstruction: photo name -> (Lens, world-to-camera).
    `names`: the model's image name -> photo name; other images are left out. InputError for a pose
    that is none.
    """
    out = {}
    for image in model.images.values():
        if image.has_pose and image.name in names:
            pose = pose_of_colmap(image.cam_from_world(), image.name)
            out[names[image.name]] = (lens_of_colmap(model.cameras[image.camera_id]), pose)
    return out


def pose_of_colmap(world_to_camera: pycolmap.Rigid3d, name: str) -> np.ndarray:
    """World-to-camera (4, 4) of the image called `name`. InputError where it is none."""
    turn, shift = world_to_camera.rotation.quat, world_to_camera.translation
    if not (np.isfinite([*turn, *shift]).all() and 0.01 < np.linalg.norm(turn) < 100):
        raise InputError(
            f"the pose of image {name} is none",
            "sparse/0",
            "export the model again, or remove that image from it",
        )
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_quat(turn).as_matrix()
    pose[:3, 3] = shift
    return pose
