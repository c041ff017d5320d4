"""Cameras around the origin, and what base colour, roughness and metallic they truly see.

Frame: Y-up, the object at the origin; an asset's mesh is Z-up.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image
from scipy import ndimage

from pipeline.base.images import write_exr
from pipeline.geometry.cameras import OPENCV_FROM_OPENGL, Y_FROM_Z_UP, View
from pipeline.render.observe import Tracer

FIELD_OF_VIEW = 40.0  # degrees
DISTANCE = 3.3  # of the cameras from the origin
GOLDEN_ANGLE = 2.399963


def camera_positions(
    count: int, seed: int, lowest: float = -10.0, highest: float = 65.0
) -> np.ndarray:
    """Camera centres (count, 3), spread evenly between two elevations in degrees."""
    rng = np.random.default_rng(seed)
    low, high = np.sin(np.radians([lowest, highest]))
    y = low + (high - low) * (np.arange(count) + 0.5) / count
    azimuth = GOLDEN_ANGLE * np.arange(count) + rng.uniform(0, 2 * np.pi)
    across = np.sqrt(1 - y**2)
    return DISTANCE * np.stack([across * np.sin(azimuth), y, across * np.cos(azimuth)], -1)


def transform_matrix(position: np.ndarray) -> list:
    """Camera-to-world (4, 4) of transforms.json: OpenGL axes, Z-up world."""
    backward = position / np.linalg.norm(position)
    right = np.cross([0, 1, 0], backward)
    right /= np.linalg.norm(right)

    matrix = np.eye(4)
    matrix[:3] = np.stack([right, np.cross(backward, right), backward, position], 1)
    return (Y_FROM_Z_UP.T @ matrix).tolist()


def view_of(position: np.ndarray, size: int) -> View:
    """The camera of `sensor` as the pipeline has it."""
    camera_to_world = Y_FROM_Z_UP @ transform_matrix(position) @ OPENCV_FROM_OPENGL
    focal = 0.5 * size / np.tan(0.5 * np.radians(FIELD_OF_VIEW))
    middle = size / 2
    return View("", "", size, size, focal, focal, middle, middle, np.linalg.inv(camera_to_world))


def texture_values(path: Path, uv: np.ndarray) -> np.ndarray:
    """An 8-bit grey (n, 1) or, for base_color.png, linear colour texture (n, 3) at uv (n, 2), v up,
    between texels as the renderer has it: bilinear, and repeated outside of [0, 1].
    """
    colored = path.name == "base_color.png"
    with Image.open(path) as image:
        texture = np.asarray(image.convert("RGB" if colored else "L"), np.float64) / 255
    if colored:  # in double precision, unlike base.images: this is the truth
        texture = np.where(texture <= 0.04045, texture / 12.92, ((texture + 0.055) / 1.055) ** 2.4)
    texture = np.atleast_3d(texture)
    h, w, channels = texture.shape
    at = [(1 - uv[:, 1]) * h - 0.5, uv[:, 0] * w - 0.5]
    read = lambda grey: ndimage.map_coordinates(grey, at, order=1, mode="grid-wrap")
    return np.stack([read(texture[..., c]) for c in range(channels)], 1)


def write_truth(asset: Path, position: np.ndarray, size: int, out: Path, name: str) -> None:
    """Base colour, roughness and metallic of one view under truth/, means over each pixel's share
    of the object; zero where it shows nothing.
    """
    tracer = Tracer(asset / "mesh.ply", Y_FROM_Z_UP)
    keys = {"albedo": "base_color.png", "roughness": "roughness.png", "metallic": "metallic.png"}
    look_up = lambda uv: np.concatenate([texture_values(asset / f, uv) for f in keys.values()], 1)
    means = tracer.pixel_means(view_of(position, size), look_up)
    write_exr(out / "truth" / "albedo" / f"{name}.exr", means[..., :3])
    write_exr(out / "truth" / "roughness" / f"{name}.exr", means[..., 3])
    write_exr(out / "truth" / "metallic" / f"{name}.exr", means[..., 4])
