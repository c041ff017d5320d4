"""Rectangles and spheres, path traced with Mitsuba from one point in all directions (for `rooms`).

Every surface is a rectangle with a colour per vertex, all in one mesh, so that kernels compile once
for all rooms; emitters are Mitsuba's own shapes. Sunlight through windows is added at the first
hit. Units are metres and relative radiance.
"""

from __future__ import annotations

import drjit as dr
import numpy as np

from pipeline.base.runtime import mitsuba as mi
from pipeline.base.runtime import mitsuba_rays
from pipeline.render.envmap import direction_from_uv

MAX_DEPTH = 7  # Mitsuba's counting: five bounces of indirect light
FACES = [(axis, end) for axis in range(3) for end in (0, 1)]


class Quads:
    """Rectangles as one triangle mesh with a colour per vertex."""

    def __init__(self):
        self.points = []
        self.colors = []
        self.count = 0

    def add(self, corner, a, b, color) -> None:
        """A rectangle corner + s a + t b, facing a x b; `color` is (3,) or (n, m, 3), values at n x
        m points along a and b.
        """
        color = np.broadcast_to(color, (2, 2, 3)) if np.ndim(color) == 1 else np.asarray(color)
        s, t = (np.linspace(0, 1, n)[..., None] for n in color.shape[:2])
        grid = corner + s[:, None] * a + t[None] * b
        for i in range(len(s) - 1):
            for j in range(len(t) - 1):
                cell = (slice(i, i + 2), slice(j, j + 2))
                self.points.append(grid[cell].reshape(4, 3))
                self.colors.append(color[cell].reshape(4, 3))
                self.count += 1

    def box(self, low, high, color, faces=FACES) -> None:
        """An axis-aligned box seen from outside."""
        size = np.asarray(high) - low
        for axis, end in faces:
            u, v = [np.eye(3)[(axis + k) % 3] * size for k in (1, 2)]
            corner = np.asarray(low) + np.eye(3)[axis] * size * end
            self.add(corner, *((u, v) if end else (v, u)), color)

    def mesh(self):
        """A two-sided diffuse Mitsuba mesh of these reflectances."""
        props = mi.Properties()
        reflectance = {"type": "mesh_attribute", "name": "vertex_color"}
        props["mesh_bsdf"] = mi.load_dict(
            {"type": "twosided", "b": {"type": "diffuse", "reflectance": reflectance}}
        )
        first = 4 * np.arange(self.count)[:, None, None]
        faces = (np.array([[0, 2, 3], [0, 3, 1]])[None] + first).reshape(-1, 3)
        mesh = mi.Mesh(
            "quads", 4 * self.count, 2 * self.count, props=props, has_vertex_normals=False
        )
        params = mi.traverse(mesh)
        params["vertex_positions"] = np.concatenate(self.points).astype(np.float32).ravel()
        params["faces"] = faces.astype(np.uint32).ravel()
        params.update()
        mesh.add_attribute(
            "vertex_color", 3, np.concatenate(self.colors).astype(np.float32).ravel()
        )
        return mesh


def glowing(corner, a, b, radiance) -> dict:
    """Mitsuba rectangle corner + s a + t b that emits `radiance` towards a x b: (3,), or (n, m, 3)
    along a and b.

    As a bitmap, because Mitsuba samples emitters by bitmaps but not by colours of vertices.
    """
    normal = np.cross(a, b)
    area = np.linalg.norm(normal)
    matrix = np.eye(4)
    matrix[:3] = np.stack([a / 2, b / 2, normal / area, corner + a / 2 + b / 2], 1)

    if np.ndim(radiance) == 1:
        image = np.broadcast_to(radiance, (2, 2, 3))
    else:
        image = np.swapaxes(radiance, 0, 1)
    image = np.ascontiguousarray(image, np.float32)

    return {
        "type": "rectangle",
        "to_world": mi.ScalarTransform4f(matrix),
        "bsdf": {"type": "diffuse", "reflectance": 0.1},
        "emitter": {
            "type": "area",
            "sampling_weight": float(area * image.mean() + 1e-6),
            "radiance": {
                "type": "bitmap",
                "data": mi.TensorXf(image),
                "raw": True,
                "wrap_mode": "clamp",
            },
        },
    }


def bulb(center, radius: float, radiance) -> dict:
    """Mitsuba sphere that emits `radiance` (3,)."""
    flux = float(4 * np.pi * radius**2 * np.mean(radiance))
    glow = {
        "type": "area",
        "sampling_weight": flux,
        "radiance": {"type": "rgb", "value": [float(c) for c in radiance]},
    }
    return {
        "type": "sphere",
        "center": [float(c) for c in center],
        "radius": float(radius),
        "emitter": glow,
    }


def trace(
    quads: Quads, lamps: list[dict], eye, h: int, w: int, spp: int, seed: int, sun=None
) -> np.ndarray:
    """Radiance (h, w, 3) seen from `eye`. sun: (towards it (3,), irradiance (3,)), let in by lamps
    only.
    """
    parts = {f"lamp{k}": lamp for k, lamp in enumerate(lamps)}
    scene = mi.load_dict({"type": "scene", "room": quads.mesh(), **parts})
    integrator = mi.load_dict({"type": "path", "max_depth": MAX_DEPTH, "rr_depth": 20})
    rng = np.random.default_rng(seed)
    total = np.zeros((h, w, 3))

    batch = max(1, 2**19 // (w * spp))  # rows at a time: memory
    for first in range(0, h, batch):
        v = np.repeat(np.arange(first, min(first + batch, h)), w * spp)
        u = np.tile(np.repeat(np.arange(w), spp), len(v) // (w * spp))
        ray_d = direction_from_uv((u + rng.random(len(u))) / w, (v + rng.random(len(v))) / h)
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(seed * 131 + first, len(u))

        rays = mitsuba_rays(np.broadcast_to(eye, ray_d.shape), ray_d)
        sampled, *_ = integrator.sample(scene, sampler, mi.RayDifferential3f(rays), active=True)
        seen = np.array(sampled).T
        if sun is not None:
            seen = seen + _sunlight(scene, rays, *sun)
        total[first : first + batch] = seen.reshape(-1, w, spp, 3).mean(2)
    return total


def _sunlight(scene, rays, towards, irradiance) -> np.ndarray:
    """Radiance (n, 3) of sunlight that reaches the first hit through an emitter (a window)."""
    si = scene.ray_intersect(rays)
    d = mi.Vector3f(towards.tolist())
    cosine = dr.abs(dr.dot(si.n, d))

    way = scene.ray_intersect(si.spawn_ray(d))
    inside = dr.dot(way.n, d) < 0
    lit = si.is_valid() & way.is_valid() & inside
    lit &= way.shape.emitter() != None  # noqa: E711  (a Dr.Jit comparison)
    lit &= dr.dot(si.wi, mi.Vector3f(0, 0, 1)) > 0

    albedo = np.array(si.bsdf().eval_diffuse_reflectance(si)).T
    lit &= si.shape.emitter() == None  # noqa: E711
    return albedo / np.pi * (np.array(cosine) * np.array(lit))[:, None] * irradiance
