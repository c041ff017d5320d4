"""Texture size: no finer than the photos.

A pixel of side 1 / f radians, at distance t and seen under the angle theta, covers the area

    A = t^2 omega / cos theta,    omega = z^3 / (f_x f_y)

of the surface (omega: its solid angle; z: the cosine between its ray and the camera's axis). With
the atlas' scale at the triangle that it meets, texture area over surface area, sqrt(A scale) is its
side on the atlas: the ground sampling distance. A texture of side s has a texel of side 1 / s.
"""

from __future__ import annotations

import numpy as np

from pipeline.base.runtime import mitsuba_rays
from pipeline.geometry.mesh_io import Mesh
from pipeline.render.observe import Observations

PIXELS = 40_000  # whose footprint is taken: the median's standard error is then below 1 %
SMALLEST = 16  # texels a side
# times the median pixel that a texel may be wide: of .94 in place of .71 a scene with sharp edges
# loses .8 dB held out, of .8 in place of .6 another one loses .05
WIDEST = 0.8
QUANTILES = (0.1, 0.25, 0.5, 0.75, 0.9)


def atlas_scale(mesh: Mesh) -> np.ndarray:
    """Texture area per surface area of every face (f,); the atlas has the area 1. Faces without
    area have the scale 0.
    """
    assert mesh.uv is not None  # the atlas stage gives every mesh its own
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces], 1, 0)
    surface = np.linalg.norm(np.cross(b - a, c - a), axis=1)

    u, v, w = np.moveaxis(mesh.uv[mesh.faces], 1, 0)
    (x1, y1), (x2, y2) = (v - u).T, (w - u).T
    return np.abs(x1 * y2 - x2 * y1) / np.where(surface > 0, surface, np.inf)


def sampling_distance(
    observations: Observations, scene: object, mesh: Mesh, rng: np.random.Generator
) -> np.ndarray:
    """Side on the atlas, which has the side 1, of what a pixel covers, for random observed pixels
    (k,). scene: Mitsuba's, with `mesh` as its only surface.
    """
    count = min(PIXELS, len(observations))
    index = rng.choice(len(observations), count, replace=False)
    origins, directions = observations.centre_rays(index)
    si = scene.ray_intersect(mitsuba_rays(origins, directions))  # type: ignore[attr-defined]
    hit = np.array(si.is_valid()).astype(bool)
    distance = np.array(si.t)[hit]
    face = np.array(si.prim_index)[hit]

    view = observations.view[index[hit]]
    along_axis = (observations.turn[view, 2] * directions[hit]).sum(1)
    solid_angle = along_axis**3 / observations.lens[view, :2].prod(1)
    area = distance**2 * solid_angle / np.maximum(observations.cosine[index[hit]], 1e-3)
    return np.sqrt(area * atlas_scale(mesh)[face])


def usual_side(least: float) -> int:
    """The least power of two, or three quarters of one, that is not less than `least`. Either is
    halved into whole mip levels, and stored in blocks of four texels.
    """
    power = 2 ** int(np.ceil(np.log2(max(least, SMALLEST))))
    return power * 3 // 4 if power * 3 / 4 >= max(least, SMALLEST) else power


def texture_size(distance: np.ndarray, most: int) -> tuple[int, dict]:
    """Side of the texture, and the evidence: the least `usual_side` at which a texel is at most
    WIDEST times as wide as the median pixel, of ground sampling distances (k,); between SMALLEST
    and `most`.
    """
    needed = 1 / float(np.median(distance))
    chosen = min(usual_side(needed / WIDEST), most)
    texels = np.quantile(distance * most, QUANTILES)
    return chosen, {
        "texels_for_one_each_pixel": needed,
        "texels_per_pixel_side_as_configured": dict(
            zip((f"{q:.0%}" for q in QUANTILES), texels.tolist(), strict=True)
        ),
        "texels_per_pixel_side_as_chosen": float(np.median(distance) * chosen),
    }
