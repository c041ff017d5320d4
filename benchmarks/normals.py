"""Shading normals of a mesh against truth, pixel by pixel, as a camera sees them.

python -m benchmarks.normals --mesh work/nerf_lego/mesh/mesh.ply \\
    --cameras work/nerf_lego/poses/cameras.json --scene FOLDER

Against a true mesh: `benchmarks.geometry`, which first brings both into one frame. Against pictures
of true normals: this command, for scenes of the NeRF-synthetic set, whose test views have them
(FOLDER/test/r_0_normal.png).

A shading normal is what light falls on: the vertex normals, interpolated over the triangle that the
pixel's central ray meets. Pixels count where both surfaces are met.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

from pipeline.base.errors import InputError, run_stage
from pipeline.base.files import read_json
from pipeline.base.images import read_png, srgb_to_linear
from pipeline.geometry.cameras import Y_FROM_Z_UP, View, load_cameras
from pipeline.geometry.mesh_io import Mesh, load_mesh, unit
from pipeline.photos.capture import path_in_scene, photo_name
from pipeline.surface.preview import caster

SIDE = 320  # longest side in pixels of the views in which normals are compared
VIEWS = 12  # at most so many, evenly chosen
CLIPPED = 0.005  # by so much a true normal's length may differ from 1: .1 in a clipped component


class NormalCaster:
    """Shading normals where rays meet a mesh."""

    def __init__(self, mesh: Mesh):
        self.mesh = mesh
        self.scene, self.o3d = caster(mesh)

    def __call__(
        self, origins: np.ndarray, directions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Rays (n, 3) -> points and unit shading normals (n, 3), turned towards the ray's origin,
        and which rays hit (n,).
        """
        rays = np.concatenate([origins, directions], 1).astype(np.float32)
        found = self.scene.cast_rays(self.o3d.core.Tensor(rays))
        distance = found["t_hit"].numpy()
        hit = np.isfinite(distance)

        corners = self.mesh.faces[np.where(hit, found["primitive_ids"].numpy(), 0)]
        second, third = found["primitive_uvs"].numpy().T
        shares = np.stack([1 - second - third, second, third], 1)
        normals = unit(np.einsum("nk,nkc->nc", shares, self.mesh.normals[corners]))

        # which side of a face is its front may differ between two makers of meshes
        geometric = found["primitive_normals"].numpy()
        away = (geometric * directions).sum(1) > 0
        normals = np.where(away[:, None], -normals, normals)
        return origins + np.where(hit, distance, 0)[:, None] * directions, normals, hit


def chosen(views: list[View], limit: int = VIEWS) -> list[View]:
    """At most `limit` of the views, evenly, at the size in which normals are compared."""
    even = np.unique(np.linspace(0, len(views) - 1, min(limit, len(views))).round().astype(int))
    small = lambda view: view.scaled(min(1.0, SIDE / max(view.width, view.height)))
    return [small(views[k]) for k in even]


def pixel_rays(view: View) -> tuple[np.ndarray, np.ndarray]:
    """Origins and directions (h w, 3) of the rays through all pixels' centres."""
    u, v = np.meshgrid(np.arange(view.width) + 0.5, np.arange(view.height) + 0.5)
    origins, directions = view.rays(np.stack([u.ravel(), v.ravel()], -1))
    return np.array(origins), directions


def angles(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Degrees (n,) between unit vectors (n, 3)."""
    return np.degrees(np.arccos(np.clip((a * b).sum(1), -1, 1)))


def normal_scores(error: np.ndarray) -> dict:
    """Statistics of angular errors (n,) in degrees."""
    return {
        "normal_error_median_degrees": float(np.median(error)),
        "normal_error_mean_degrees": float(error.mean()),
        "normal_error_below_10_degrees": float((error < 10).mean()),
        "normal_pixels": len(error),
    }


def true_normal_pictures(scene: Path) -> dict[str, Path]:
    """View's name -> picture of its true normals, for test views that have one.

    Raises InputError where there are none.
    """
    file = scene / "transforms_test.json"
    found = {}
    for frame in read_json(file)["frames"]:
        stem = path_in_scene(scene, frame["file_path"], file)
        picture = stem.with_name(f"{stem.name}_normal.png")
        if picture.exists():
            found[photo_name(scene, stem)] = picture

    if not found:
        raise InputError("no test view has a picture of normals", file, "name a scene that has")
    return found


def read_normals(picture: Path) -> tuple[np.ndarray, np.ndarray]:
    """True unit normals (h, w, 3) in the library's Y-up frame, and which pixels have one (h, w).

    Blender wrote them like a colour: components in the cameras' own Z-up world, negative ones
    clipped to 0, sRGB-encoded. What was clipped, and what mixes two surfaces, is shorter than 1 and
    left out.
    """
    normals = srgb_to_linear(read_png(picture)[..., :3] / 255.0)
    whole = np.abs(np.linalg.norm(normals, axis=-1) - 1) < CLIPPED
    return normals @ Y_FROM_Z_UP[:3, :3].T, whole


def picture_scores(mesh: Path, cameras: Path, scene: Path) -> dict:
    """Statistics of the angles between the normals of `mesh` and the pictures of `scene`."""
    pictures = true_normal_pictures(scene)
    cast = NormalCaster(load_mesh(mesh))
    errors = []
    for view in load_cameras(cameras).views:
        if view.name in pictures:
            true, whole = read_normals(pictures[view.name])
            _, normals, hit = cast(*pixel_rays(view.scaled(whole.shape[1] / view.width)))
            both = whole.ravel() & hit
            errors.append(angles(normals[both], unit(true.reshape(-1, 3)[both])))
    return normal_scores(np.concatenate(errors))


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    for name in ("mesh", "cameras", "scene"):
        parser.add_argument(f"--{name}", type=Path, required=True)
    args = parser.parse_args()
    print(json.dumps(picture_scores(args.mesh, args.cameras, args.scene)))


if __name__ == "__main__":
    run_stage(main)
