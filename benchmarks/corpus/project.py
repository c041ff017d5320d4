"""A small project whose truth is known in closed form: photos of a painted ball, masks, cameras and
a mesh, in the forms of docs/scene_folder.md.

Frame: Y-up, the ball of radius RADIUS at the origin; files with cameras and meshes are Z-up.
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import numpy as np
import yaml
from PIL import Image

from pipeline.base.images import to_srgb8
from pipeline.geometry.cameras import OPENCV_FROM_OPENGL, Y_FROM_Z_UP, View
from pipeline.geometry.mesh_io import unit

VIEWS = 4
WIDTH = 72
HEIGHT = 56
FOCAL = 90.0
RADIUS = 0.5
DISTANCE = 2.2
GROUND = 0.05  # linear radiance beside the ball


def pose(number: int) -> np.ndarray:
    """World-to-camera (4, 4) of a view: on a ring, by turns below and above the ball's middle."""
    azimuth = 2 * np.pi * number / VIEWS + 0.3
    height = 0.9 if number % 2 else -0.2
    position = np.array([np.sin(azimuth), height, np.cos(azimuth)])
    position *= DISTANCE / np.linalg.norm(position)

    forward = -position / DISTANCE
    right = np.cross(forward, [0, 1, 0])
    right /= np.linalg.norm(right)
    out = np.eye(4)
    out[:3, :3] = np.stack([right, np.cross(forward, right), forward])
    out[:3, 3] = -out[:3, :3] @ position
    return out


def view(number: int) -> View:
    """One of the ball's views."""
    middle = WIDTH / 2, HEIGHT / 2
    return View(f"p{number}", "", WIDTH, HEIGHT, FOCAL, FOCAL, *middle, pose(number))


def paint(direction: np.ndarray) -> np.ndarray:
    """Linear colour (..., 3) of the ball in unit directions (..., 3) from its middle."""
    stripes = np.sin(9 * direction) * np.sin(7 * direction[..., [1, 2, 0]] + 1)
    return 0.4 + 0.25 * stripes


def picture(number: int) -> tuple[np.ndarray, np.ndarray]:
    """Linear photo (HEIGHT, WIDTH, 3) of a view and its mask (HEIGHT, WIDTH) bool."""
    camera = view(number)
    origin, direction = camera.rays(camera.pixel_centers())
    along = (origin * direction).sum(-1)
    root = along**2 - (origin**2).sum(-1) + RADIUS**2
    hit = root > 0

    point = origin + (-along - np.sqrt(np.maximum(root, 0)))[..., None] * direction
    color = paint(unit(point.reshape(-1, 3)).reshape(point.shape))
    return np.where(hit[..., None], color, GROUND).astype(np.float32), hit


def transform_matrix(number: int) -> list:
    """Camera-to-world of transforms.json: OpenGL axes, Z-up world."""
    return (Y_FROM_Z_UP.T @ np.linalg.inv(pose(number)) @ OPENCV_FROM_OPENGL).tolist()


def ball(rings: int = 12) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (n, 3) on the ball, Z-up, and triangles (m, 3), counter-clockwise from outside."""
    around = 2 * rings
    elevation = np.pi * (np.arange(1, rings) / rings - 0.5)
    azimuth = 2 * np.pi * np.arange(around) / around
    e, a = np.meshgrid(elevation, azimuth, indexing="ij")
    grid = np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], -1)
    vertices = np.concatenate([grid.reshape(-1, 3), [[0, 0, -1], [0, 0, 1]]])

    k, j = np.meshgrid(np.arange(rings - 2), np.arange(around), indexing="ij")
    here = (k * around + j).ravel()
    right = (k * around + (j + 1) % around).ravel()
    faces = np.concatenate(
        [
            np.stack([here, right, right + around], 1),
            np.stack([here, right + around, here + around], 1),
        ]
    )
    last = (rings - 2) * around
    low, high = len(vertices) - 2, len(vertices) - 1
    column = np.arange(around)
    after = (column + 1) % around
    bottom = np.stack([np.full(around, low), after, column], 1)
    top = np.stack([np.full(around, high), last + column, last + after], 1)
    return RADIUS * vertices, np.concatenate([faces, bottom, top])


def obj_text(vertices: np.ndarray, faces: np.ndarray) -> str:
    """A mesh as OBJ, without normals and texture coordinates."""
    lines = [f"v {x:.7g} {y:.7g} {z:.7g}" for x, y, z in vertices]
    lines += ["f " + " ".join(str(corner + 1) for corner in face) for face in faces]
    return "\n".join(lines) + "\n"


class Project:
    """A project folder with one scene, whose files a case spoils.

    name: of the scene, whose configuration is configs/<name>.yaml; photos: the scene folder's name.
    """

    def __init__(self, folder: Path, name: str = "s", photos: str = "photos"):
        self.folder = folder
        self.name = name
        self.scene = folder / photos
        self.images = self.scene / "images"
        self.masks = self.scene / "masks"
        self.transforms = self.scene / "transforms.json"
        self.settings: dict = {"photos": photos, "preset": "draft"}
        self.cut_after: dict[str, str] = {}  # stage -> file of its result to be cut in the middle

    def make(self) -> None:
        """Write a scene with which nothing is wrong."""
        for folder in (self.images, self.masks, self.folder / "configs"):
            folder.mkdir(parents=True)
        for number in range(VIEWS):
            linear, mask = picture(number)
            Image.fromarray(to_srgb8(linear)).save(self.images / f"p{number}.png")
            Image.fromarray(mask * np.uint8(255)).save(self.masks / f"p{number}.png")
        self.write_cameras(self.cameras())
        (self.scene / "mesh.obj").write_text(obj_text(*ball()), encoding="utf-8")
        self.write_config()

    def cameras(self) -> dict:
        """What transforms.json holds."""
        frames = [
            {"file_path": f"images/p{k}.png", "transform_matrix": transform_matrix(k)}
            for k in range(VIEWS)
        ]
        return {"fl_x": FOCAL, "w": WIDTH, "h": HEIGHT, "frames": frames}

    def write_cameras(self, cameras: dict) -> None:
        self.transforms.write_text(json.dumps(cameras), encoding="utf-8")

    def write_config(self) -> None:
        text = yaml.safe_dump(self.settings, allow_unicode=True)
        self.config.write_text(text, encoding="utf-8")

    @property
    def config(self) -> Path:
        return self.folder / "configs" / f"{self.name}.yaml"

    @property
    def work(self) -> Path:
        return self.folder / "work" / self.name

    def result(self, stage: str) -> dict:
        """A stage's metrics."""
        return json.loads((self.work / stage / f"{stage}.json").read_text(encoding="utf-8"))

    def users_files(self) -> dict[str, str]:
        """Digest of every file that is the user's own: all but those below work/ and exports/."""
        made = (self.folder / "work", self.folder / "exports")
        return {
            str(file.relative_to(self.folder)): hashlib.sha256(file.read_bytes()).hexdigest()
            for file in sorted(self.folder.rglob("*"))
            if file.is_file() and not any(file.is_relative_to(m) for m in made)
        }
