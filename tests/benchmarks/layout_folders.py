"""Small folders in the layouts of public data sets, written from one rendered scene.

Maps are made by formulas of their own, from what the sets say about their frames, and not by the
readers' code. Frame: the sets' Z-up world.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from benchmarks.make_scene import Options, make_scene
from pipeline.base.images import linear_to_srgb, read_exr, read_png, write_exr, write_png
from pipeline.geometry.cameras import Y_FROM_Z_UP
from pipeline.geometry.mesh_io import Mesh, load_mesh, save_mesh

Light = Callable[[np.ndarray], np.ndarray]
ROWS = 32
SIZE = 40
OPENCV = np.diag([1.0, -1, -1, 1])  # axes: y down, z ahead
BACKGROUND = 0.3  # of photos that are not cut out
BASE_COLORS = (190, 120, 60), (60, 120, 160)  # sRGB, of the ball's halves


def glow(toward, color) -> Light:
    """A dim surrounding with one bright side: directions (n, 3) -> radiance (n, 3)."""
    middle = np.asarray(toward) / np.linalg.norm(toward)
    return lambda d: 0.4 + np.exp(10 * (d @ middle - 1))[:, None] * np.asarray(color)


OWN = glow((0.6, -0.5, 0.6), (6, 5, 4))
OTHER = glow((-0.8, 0.3, 0.5), (3, 5, 7))


def grid(rows: int) -> tuple[np.ndarray, np.ndarray]:
    """u and the angle from the pole of pixel centres, (rows, 2 rows) each."""
    u, v = np.meshgrid((np.arange(2 * rows) + 0.5) / (2 * rows), (np.arange(rows) + 0.5) / rows)
    return u, np.pi * v


def our_map(light: Light, rows: int = ROWS) -> np.ndarray:
    """Heliograph's frame: +Y on top, longitude atan2(x, z) falls from left to right."""
    u, polar = grid(rows)
    lon = 2 * np.pi * (0.5 - u)
    x, y, z = np.sin(polar) * np.sin(lon), np.cos(polar), np.sin(polar) * np.cos(lon)
    return painted(light, np.stack([x, -z, y], -1))


def blender_map(light: Light, rows: int = ROWS) -> np.ndarray:
    """Blender's frame: +Z on top, azimuth atan2(y, x) falls from left to right."""
    u, polar = grid(rows)
    azimuth = 2 * np.pi * (0.5 - u)
    x, y = np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth)
    return painted(light, np.stack([x, y, np.cos(polar)], -1))


def camera_map(light: Light, pose: np.ndarray, rows: int = ROWS) -> np.ndarray:
    """Stanford-ORB's frame: the camera's up on top, what it looks at in the middle, its right to
    the right of that.
    """
    u, polar = grid(rows)
    turn = 2 * np.pi * (u - 0.5)
    x, y, z = np.sin(polar) * np.sin(turn), np.cos(polar), -np.sin(polar) * np.cos(turn)
    return painted(light, np.stack([x, y, z], -1) @ pose[:3, :3].T)


def painted(light: Light, d: np.ndarray) -> np.ndarray:
    return light(d.reshape(-1, 3)).reshape(d.shape).astype(np.float32)


@dataclass
class Toy:
    """A scene folder of make_scene, its views and what they show. poses: camera to world (4, 4),
    OpenGL axes, by view; own, other: its lights at the pictures' exposure.
    """

    scene: Path
    angle: float
    poses: dict[str, np.ndarray]
    own: Light
    other: Light

    def names(self, split: str) -> list[str]:
        return [name for name in self.poses if name.startswith(split)]

    def linear(self, name: str) -> np.ndarray:
        return read_exr(self.scene / "truth" / "linear" / f"{name}.exr")

    def relit(self, name: str) -> np.ndarray:
        return read_exr(self.scene / "truth" / "relight" / "other" / f"{name}.exr")

    def albedo(self, name: str) -> np.ndarray:
        return read_exr(self.scene / "truth" / "albedo" / f"{name}.exr")

    def mask(self, name: str) -> np.ndarray:
        return read_png(self.scene / "masks" / f"{name}.png") > 127

    def on_background(self, linear: np.ndarray, name: str) -> np.ndarray:
        return np.where(self.mask(name)[..., None], linear, BACKGROUND)


def make_toy(mesh_file: Path, folder: Path) -> Toy:
    """The two-coloured ball in the light OWN, with relit views in OTHER."""
    mesh = load_mesh(mesh_file)
    back = Y_FROM_Z_UP[:3, :3]
    asset = folder / "asset"
    asset.mkdir()
    z_up = Mesh(mesh.vertices @ back, mesh.faces, mesh.normals @ back, mesh.uv)
    save_mesh(asset / "mesh.ply", z_up)
    color = np.full((16, 16, 3), BASE_COLORS[0])
    color[:, 8:] = BASE_COLORS[1]
    write_png(asset / "base_color.png", color)
    write_png(asset / "roughness.png", np.full((16, 16), 128))
    write_png(asset / "metallic.png", np.zeros((16, 16)))

    for name, light in (("own", OWN), ("other", OTHER)):
        write_exr(folder / f"{name}.exr", our_map(light))
    options = Options(size=SIZE, spp=128, views=4, test=2)
    scene = folder / "scene"
    make_scene(asset, folder / "own.exr", [folder / "other.exr"], options, scene)

    cameras = [json.loads((scene / f"transforms{s}.json").read_text()) for s in ("", "_test")]
    frames = [frame for data in cameras for frame in data["frames"]]
    poses = {Path(f["file_path"]).stem: np.array(f["transform_matrix"]) for f in frames}
    exposed = lambda file, light: scaled(light, read_exr(scene / "truth" / file))
    own, other = exposed("envmap.exr", OWN), exposed("relight/other.exr", OTHER)
    return Toy(scene, cameras[0]["camera_angle_x"], poses, own, other)


def scaled(light: Light, shown: np.ndarray) -> Light:
    """The light at the exposure of a map of it."""
    factor = float(shown.mean() / our_map(light).mean())
    return lambda d: factor * light(d)


def encoded(linear: np.ndarray) -> np.ndarray:
    """8-bit sRGB."""
    return np.round(255 * linear_to_srgb(linear)).astype(np.uint8)


def write_rgba(file: Path, rgb: np.ndarray, mask: np.ndarray) -> None:
    """8-bit colours with straight alpha; colours of what is cut out are arbitrary."""
    file.parent.mkdir(parents=True, exist_ok=True)
    colors = np.where(mask[..., None], rgb, 77).astype(np.uint8)
    Image.fromarray(np.dstack([colors, 255 * mask.astype(np.uint8)])).save(file)


def write_picture(file: Path, pixels: np.ndarray, **how) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(pixels).save(file, **how)


def write_json(file: Path, data: object) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(json.dumps(data), encoding="utf-8")


def nerf_synthetic(toy: Toy, folder: Path) -> Path:
    for split in ("train", "test"):
        frames = []
        for k, name in enumerate(toy.names(split)):
            photo = folder / split / f"r_{k}.png"
            write_rgba(photo, encoded(toy.linear(name)), toy.mask(name))
            pose = toy.poses[name].tolist()
            frames.append(
                {"file_path": f"./{split}/r_{k}", "rotation": 0.01, "transform_matrix": pose}
            )
        data = {"camera_angle_x": toy.angle, "frames": frames}
        write_json(folder / f"transforms_{split}.json", data)
    return folder


def tensoir(toy: Toy, folder: Path) -> Path:
    """folder/object and folder/lights, which has another frame and no map of the light `night`."""
    for name, pose in toy.poses.items():
        view = folder / "object" / name
        mask = toy.mask(name)
        write_rgba(view / "rgba_sunset.png", encoded(toy.linear(name)), mask)
        if name.startswith("test"):
            write_rgba(view / "rgba_city.png", encoded(toy.relit(name)), mask)
            write_rgba(view / "rgba_night.png", encoded(0.1 * toy.relit(name)), mask)
        albedo = np.round(255 * toy.albedo(name)).astype(np.uint8)
        write_rgba(view / "albedo.png", albedo, mask)
        about = {
            "cam_transform_mat": ",".join(str(x) for x in pose.ravel()),
            "cam_angle_x": toy.angle,
            "envmap": "elsewhere.hdr",
            "envmap_inten": 3,
            "imw": SIZE,
            "imh": SIZE,
        }
        write_json(view / "metadata.json", about)
    (folder / "lights").mkdir()
    write_exr(folder / "lights" / "sunset.exr", blender_map(toy.own))
    write_exr(folder / "lights" / "city.exr", blender_map(toy.other))
    return folder / "object"


def stanford_orb(toy: Toy, folder: Path) -> Path:
    """The ball in scene001, its relit views in scene002, which has its own names for them."""
    sets = {"scene001": toy.linear, "scene002": toy.relit}
    for scene, shown in sets.items():
        for split in ("train", "test"):
            for k, name in enumerate(toy.names(split)):
                if (scene, split) == ("scene002", "train"):
                    continue
                linear = toy.on_background(shown(name), name)
                at = f"ball_{scene}/{split}/{k:04d}"
                write_exr(folder / "blender_HDR" / f"{at}.exr", linear)
                for kind in ("HDR", "LDR"):
                    mask = folder / f"blender_{kind}" / f"ball_{scene}/{split}_mask/{k:04d}.png"
                    write_picture(mask, 255 * toy.mask(name).astype(np.uint8))
                write_picture(folder / "blender_LDR" / f"{at}.png", encoded(linear))

    cameras: dict[str, list[dict]] = {"train": [], "test": [], "novel": []}
    for split in ("train", "test"):
        for k, name in enumerate(toy.names(split)):
            pose = toy.poses[name].tolist()
            cameras[split].append({"file_path": f"{split}/{k:04d}", "transform_matrix": pose})
    for frame in cameras["test"]:
        of_scene = {"scene_name": "ball_scene002", "camera_angle_x": toy.angle}
        cameras["novel"].append(frame | of_scene)
    for kind in ("HDR", "LDR"):
        for split, frames in cameras.items():
            whole = {} if split == "novel" else {"camera_angle_x": toy.angle}
            file = folder / f"blender_{kind}" / "ball_scene001" / f"transforms_{split}.json"
            write_json(file, whole | {"frames": frames})

    for scene, light in (("scene001", toy.own), ("scene002", toy.other)):
        truth = folder / "ground_truth" / f"ball_{scene}"
        for k, name in enumerate(toy.names("test")):
            seen = camera_map(light, toy.poses[name])
            write_exr(truth / "env_map" / f"{k:04d}.exr", seen)
            write_picture(truth / "pseudo_gt_albedo" / f"{k:04d}.png", encoded(toy.albedo(name)))
    return folder / "blender_LDR" / "ball_scene001"


def open_illumination(toy: Toy, folder: Path, axes: np.ndarray = OPENCV) -> Path:
    """folder/object, and folder/lights as `tensoir` has it. axes: from OpenGL's to the file's."""
    thing = folder / "object"
    for split in ("train", "test"):
        frames = {}
        for k, name in enumerate(toy.names(split)):
            camera = f"{'CNE'[k % 3]}{split[-1]}{k}"
            mask = toy.mask(name).astype(np.uint8)
            for kind in ("obj_masks", "com_masks"):
                write_picture(thing / "output" / kind / f"{camera}.png", mask)
            for pattern, shown in (("013", toy.linear), ("001", toy.relit)):
                if (split, pattern) != ("train", "001"):
                    photo = thing / "Lights" / pattern / "raw_undistorted" / f"{camera}.JPG"
                    pixels = encoded(toy.on_background(shown(name), name))
                    write_picture(photo, pixels, quality=98, subsampling=0)
            frames[camera] = {
                "file_path": camera,
                "camera_angle_x": toy.angle,
                "calib_imgw": SIZE,
                "transform_matrix": (toy.poses[name] @ axes).tolist(),
            }
        write_json(thing / "output" / f"transforms_alignz_{split}.json", {"frames": frames})
    (folder / "lights").mkdir(exist_ok=True)
    write_exr(folder / "lights" / "013.exr", blender_map(toy.own))
    write_exr(folder / "lights" / "001.exr", blender_map(toy.other))
    return thing


WRITERS = {
    "nerf_synthetic": nerf_synthetic,
    "tensoir": tensoir,
    "stanford_orb": stanford_orb,
    "open_illumination": open_illumination,
}
