"""Shading normals of a mesh against truth, pixel by pixel, as a camera sees them.

python -m benchmarks.normals --mesh work/nerf_lego/atlas/mesh_uv.ply \\
    --cameras work/nerf_lego/poses/cameras.json --scene FOLDER

Against a true mesh: `benchmarks.geometry`, which first brings both into one frame. Against pictures
of true normals: this command, for scenes of the NeRF-synthetic set, whose test views have them
(FOLDER/test/r_0_normal.png).

A shading normal is what light falls on: the vertex normals, interpolated over the triangle that the
pixel's central ray meets, then tilted by the normal map where one lies beside the mesh (FILE:
tangent space, 8 or 16 bits, red along dp/du of the face, green up). Pixels count where both
surfaces are met.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import cv2
import numpy as np

from pipeline.base.errors import InputError, run_stage
from pipeline.base.images import read_png, srgb_to_linear
from pipeline.geometry.cameras import Y_FROM_Z_UP, View, load_cameras
from pipeline.geometry.mesh_io import Mesh, load_mesh, unit
from pipeline.geometry.normal_maps import FILE
from pipeline.geometry.surface import Surface
from pipeline.posterior.textures import gather
from pipeline.surface.preview import caster

PICTURE_END = "_normal.png"
SIDE = 320  # longest side in pixels of the views in which normals are compared
VIEWS = 12  # at most so many, evenly chosen
CLIPPED = 0.005  # by so much a true normal's length may differ from 1: .1 in a clipped component


def read_normal_map(mesh_file: Path) -> np.ndarray | None:
    """Tangent-space normals (t, t, 3) of the map beside a mesh, None where there is none. Raises
    InputError where it cannot be read.
    """
    file = Surface.of(mesh_file).normal_map
    if file is None:
        return None
    pixels = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
    if pixels is None or pixels.ndim != 3:
        raise InputError("not a normal map", file, "run the stage that makes it again")
    full = 255 if pixels.dtype == np.uint8 else 65535
    return np.ascontiguousarray(pixels[..., 2::-1] / full * 2 - 1, np.float32)


def tilted(
    normals: np.ndarray, mesh: Mesh, faces: np.ndarray, shares: np.ndarray, normal_map: np.ndarray
) -> np.ndarray:
    """Unit normals (n, 3) tilted by the map.

    faces (n,): which face of `mesh` each one lies on; shares (n, 3): its barycentric coordinates.
    The frame's red axis is dp/du of the face, made orthogonal to the normal.
    """
    if mesh.uv is None:
        raise InputError("a mesh without uv has no normal map", FILE, "name mesh_uv.ply")
    corners = mesh.faces[faces]
    place = mesh.vertices[corners]
    uv = mesh.uv[corners]
    (u1, v1), (u2, v2) = (uv[:, 1] - uv[:, 0]).T, (uv[:, 2] - uv[:, 0]).T
    edges = v2[:, None] * (place[:, 1] - place[:, 0]) - v1[:, None] * (place[:, 2] - place[:, 0])
    tangent = np.sign(u1 * v2 - v1 * u2)[:, None] * edges

    tangent = unit(tangent - (tangent * normals).sum(1, keepdims=True) * normals)
    at = gather(normal_map, np.einsum("nk,nkc->nc", shares, uv))
    red, green, blue = (at[:, channel, None] for channel in range(3))
    return unit(red * tangent + green * np.cross(normals, tangent) + blue * normals)


class NormalCaster:
    """Shading normals where rays meet a mesh, with a normal map (t, t, 3) if it has one."""

    def __init__(self, mesh: Mesh, normal_map: np.ndarray | None = None):
        self.mesh = mesh
        self.normal_map = normal_map
        self.scene, self.o3d = caster(mesh)

    @classmethod
    def of_file(cls, mesh: Path) -> NormalCaster:
        """Of a mesh file and the normal map beside it."""
        return cls(load_mesh(mesh), read_normal_map(mesh))

    def __call__(
        self, origins: np.ndarray, directions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Rays (n, 3) -> which of them hit (n,), and of those, k in number, points and unit shading
        normals (k, 3), turned towards the ray's origin.
        """
        rays = np.concatenate([origins, directions], 1).astype(np.float32)
        found = {name: part.numpy() for name, part in self._cast(rays).items()}
        hit = np.isfinite(found["t_hit"])
        faces = found["primitive_ids"][hit]
        second, third = found["primitive_uvs"][hit].T
        shares = np.stack([1 - second - third, second, third], 1)

        normals = unit(np.einsum("nk,nkc->nc", shares, self.mesh.normals[self.mesh.faces[faces]]))
        if self.normal_map is not None:
            normals = tilted(normals, self.mesh, faces, shares, self.normal_map)

        # which side of a face is its front may differ between two makers of meshes
        away = (found["primitive_normals"][hit] * directions[hit]).sum(1) > 0
        normals = np.where(away[:, None], -normals, normals)
        return hit, origins[hit] + found["t_hit"][hit, None] * directions[hit], normals

    def _cast(self, rays: np.ndarray) -> dict:
        return self.scene.cast_rays(self.o3d.core.Tensor(rays))


def chosen(views: list[View], limit: int = VIEWS) -> list[View]:
    """At most `limit` of the views, evenly, at the size in which normals are compared."""
    even = np.unique(np.linspace(0, len(views) - 1, min(limit, len(views))).round().astype(int))
    small = lambda view: view.scaled(min(1.0, SIDE / max(view.width, view.height)))
    return [small(views[k]) for k in even]


def pixel_rays(view: View) -> tuple[np.ndarray, np.ndarray]:
    """Origins and directions (h w, 3) of the rays through all pixels' centres."""
    origins, directions = view.rays(view.pixel_centers().reshape(-1, 2))
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
    """View's name -> picture of its true normals: test_r_0 -> test/r_0_normal.png.

    Raises InputError where there are none.
    """
    files = sorted(scene.glob(f"*/*{PICTURE_END}"))
    if not files:
        raise InputError("no view has a picture of normals", scene, "name a scene that has")
    return {f"{f.parent.name}_{f.name.removesuffix(PICTURE_END)}": f for f in files}


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
    cast = NormalCaster.of_file(mesh)
    errors = []
    for view in load_cameras(cameras).views:
        if view.name in pictures:
            true, whole = read_normals(pictures[view.name])
            hit, _, normals = cast(*pixel_rays(view.scaled(whole.shape[1] / view.width)))
            known = whole.ravel()[hit]
            errors.append(angles(normals[known], unit(true.reshape(-1, 3)[hit][known])))
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
