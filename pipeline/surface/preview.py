"""Shaded pictures of a mesh by Open3D's ray caster, and silhouettes."""

from __future__ import annotations

from functools import cache
from types import ModuleType
from typing import Any

import numpy as np

from pipeline.base.runtime import import_open3d
from pipeline.geometry.cameras import View
from pipeline.geometry.mesh_io import Mesh
from pipeline.surface.zbuffer import Crop, z_buffer


def caster(mesh: Mesh) -> tuple[Any, ModuleType]:
    """Open3D's ray-casting scene of a mesh, and the module."""
    o3d = import_open3d()
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(
        o3d.core.Tensor(mesh.vertices.astype(np.float32)),
        o3d.core.Tensor(mesh.faces.astype(np.uint32)),
    )
    return scene, o3d


class Silhouette:
    """Which pixels of a view the mesh covers."""

    def __init__(self, mesh: Mesh):
        self.vertices, self.faces = mesh.vertices.astype(float), np.ascontiguousarray(mesh.faces)
        self.caster = cache(lambda: caster(mesh))

    def __call__(self, view: View) -> np.ndarray:
        """(h, w) bool: whether the mesh covers each pixel's centre. By a z-buffer, a tenth of the
        time of rays; by rays where the mesh reaches behind the camera, for a z-buffer leaves out
        triangles that do.
        """
        if (view.project(self.vertices)[1] <= 0).any():
            return self.hit(view)
        crop = Crop.around(view, self.vertices, margin=1)
        out = np.zeros((view.height, view.width), bool)
        crop.of(out)[:] = z_buffer(crop, self.vertices, self.faces)[1] >= 0
        return out

    def hit(self, view: View) -> np.ndarray:
        """(h, w) bool, by a ray through each pixel's centre."""
        scene, o3d = self.caster()
        rays = np.concatenate(view.rays(view.pixel_centers()), -1).astype(np.float32)
        hit = scene.cast_rays(o3d.core.Tensor(rays))
        return np.isfinite(hit["t_hit"].numpy())


def shaded(mesh: Mesh, size: int = 320) -> np.ndarray:
    """Four views side by side, (size, 4 size, 3) uint8."""
    scene, _ = caster(mesh)
    center = 0.5 * (mesh.vertices.min(0) + mesh.vertices.max(0))
    radius = 0.5 * np.linalg.norm(np.ptp(mesh.vertices, axis=0))
    elevation = np.radians(25)

    tiles = []
    for degrees in (20, 110, 200, 290):
        azimuth = np.radians(degrees)
        x = np.cos(elevation) * np.sin(azimuth)
        z = np.cos(elevation) * np.cos(azimuth)
        eye = center + 3.2 * radius * np.array([x, np.sin(elevation), z])
        rays = scene.create_rays_pinhole(38, center.tolist(), eye.tolist(), [0, 1, 0], size, size)
        hit = scene.cast_rays(rays)

        normal = hit["primitive_normals"].numpy()
        to_eye = (eye - center) / np.linalg.norm(eye - center)
        light = 0.25 + 0.75 * np.clip(normal @ (to_eye + [0, 0.5, 0]) / 1.1, 0, 1)
        surface = np.isfinite(hit["t_hit"].numpy())[..., None]
        tile = np.where(surface, light[..., None] * [225, 220, 210], [30, 32, 36])
        tiles.append(tile[::-1])
    return np.concatenate(tiles, 1).astype(np.uint8)
