"""What decimation takes away, as a normal map: the dense surface's normals, seen from the points of
the decimated one.

For every texel: the nearest point of the dense surface along the decimated surface's normal, on
either side, whose normal is not turned away; where there is none, the nearest point in any
direction; where that is turned away or too far, the decimated surface's own normal.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy import ndimage

from pipeline.base.config import Atlas
from pipeline.geometry.mesh_io import Mesh, load_mesh, unit
from pipeline.geometry.normal_maps import face_tangents, frames_of, mirrored_share
from pipeline.geometry.surface import Surface
from pipeline.surface.preview import caster
from pipeline.surface.raster import texel_faces

# the mesh stage's surface before decimation, its normals without noise, beside its mesh.ply
DENSE = "dense.ply"
MIRRORED = 0.001  # share of the atlas that may be mirrored: slivers
REACH = 0.02  # of the longest side: what lies farther off is another part of the object
FACING = 0.2  # least cosine between both surfaces' normals: the other side of a thin part has -1
# degrees: a map whose normals are nearer to the mesh's own, but for one texel in twenty, shows
# nothing; surfaces from photos are wrong by ten times as much
LEAST_TILT = 0.5
START = 1e-3  # of the reach: how far behind the surface rays start, to meet what coincides with it


@dataclass
class Found:
    """What a search found of the dense surface, for k points: distance (k,), infinite where nothing
    fits, and unit normals (k, 3).
    """

    distance: np.ndarray
    normal: np.ndarray

    def or_nearer(self, other: Found) -> Found:
        """The nearer of two finds at every point."""
        nearer = other.distance < self.distance
        return Found(
            np.where(nearer, other.distance, self.distance),
            np.where(nearer[:, None], other.normal, self.normal),
        )


class DenseSurface:
    """Searches on the dense surface from points of the decimated one, within `reach`."""

    def __init__(self, mesh: Mesh, reach: float):
        self.mesh = mesh
        self.reach = reach
        self.scene, self.o3d = caster(mesh)

    def _found(
        self, distance: np.ndarray, face: np.ndarray, uv: np.ndarray, facing: np.ndarray
    ) -> Found:
        """Finds on faces (k,) at barycentric coordinates uv (k, 2) of their second and third
        corner, without those out of reach or turned away from `facing` (k, 3).
        """
        hit = distance <= self.reach
        corners = self.mesh.faces[np.where(hit, face, 0)]
        weight = np.concatenate([1 - uv.sum(1, keepdims=True), uv], 1)
        normal = unit(np.einsum("kc,kcx->kx", weight, self.mesh.normals[corners]))

        fits = hit & ((normal * facing).sum(1) > FACING)
        return Found(np.where(fits, distance, np.inf), normal)

    def along(self, position: np.ndarray, direction: np.ndarray, facing: np.ndarray) -> Found:
        """The first point that rays from `position` in unit `direction` (k, 3) meet."""
        start = position - START * self.reach * direction
        rays = np.concatenate([start, direction], 1).astype(np.float32)
        hit = self.scene.cast_rays(self.o3d.core.Tensor(rays))
        return self._found(
            np.abs(hit["t_hit"].numpy() - START * self.reach),
            hit["primitive_ids"].numpy(),
            hit["primitive_uvs"].numpy(),
            facing,
        )

    def nearest(self, position: np.ndarray, facing: np.ndarray) -> Found:
        """The nearest point in any direction."""
        points = position.astype(np.float32)
        hit = self.scene.compute_closest_points(self.o3d.core.Tensor(points))
        return self._found(
            np.linalg.norm(hit["points"].numpy() - points, axis=1),
            hit["primitive_ids"].numpy(),
            hit["primitive_uvs"].numpy(),
            facing,
        )


def dense_normals(
    dense: Mesh, position: np.ndarray, facing: np.ndarray, reach: float
) -> tuple[np.ndarray, np.ndarray]:
    """Unit normals (k, 3) of the dense surface at points (k, 3) of the decimated one with unit
    normals `facing` (k, 3), and which points have any (k,); the others get `facing`.
    """
    surface = DenseSurface(dense, reach)
    found = surface.along(position, facing, facing)
    found = found.or_nearer(surface.along(position, -facing, facing))

    missed = np.flatnonzero(np.isinf(found.distance))
    if len(missed):
        rest = surface.nearest(position[missed], facing[missed])
        found.distance[missed] = rest.distance
        found.normal[missed] = rest.normal

    known = np.isfinite(found.distance)
    return np.where(known[:, None], found.normal, facing), known


def bake(low: Mesh, dense: Mesh, size: int, padding: int) -> tuple[np.ndarray, dict]:
    """Normal map (size, size, 3) of unit normals in the tangent frames of `low`, row 0 = v 1, and
    facts: share of the atlas's texels that found the dense surface, median and 95 % quantile of the
    angle between both surfaces' normals in degrees.

    Texels within `padding` of a chart hold the nearest one's normal, all others (0, 0, 1).
    """
    face, weight = texel_faces(low, size)
    covered = face >= 0
    corners = low.faces[face[covered]]
    blend = lambda values: np.einsum("kc,kcx->kx", weight[covered], values[corners])

    tangent, _ = face_tangents(low)
    frame = frames_of(tangent[face[covered]], unit(blend(low.normals)))
    reach = REACH * float(np.ptp(low.vertices, axis=0).max())
    normal, known = dense_normals(dense, blend(low.vertices), frame[:, 2], reach)

    local = unit(np.einsum("kij,kj->ki", frame, normal))
    baked = np.broadcast_to([0.0, 0.0, 1.0], (size, size, 3)).copy()
    baked[covered] = local
    tilt = np.degrees(np.arccos(np.clip(local[:, 2], -1, 1)))
    return padded(baked, covered, padding), {
        "found_share": float(known.mean()),
        "median_tilt": float(np.median(tilt)),
        "tilt_95": float(np.quantile(tilt, 0.95)),
    }


def padded(image: np.ndarray, covered: np.ndarray, padding: int) -> np.ndarray:
    """The image (t, t, c) with the nearest covered texel's values in texels within `padding`."""
    distance, nearest = ndimage.distance_transform_edt(~covered, return_indices=True)
    rim = (distance > 0) & (distance <= padding)
    image[rim] = image[tuple(nearest[:, rim])]
    return image


def make_normal_map(mesh: Path, atlas: Path, settings: Atlas) -> dict:
    """Write normal.png into `atlas`, beside its mesh_uv.ply, where the mesh stage's folder `mesh`
    keeps a dense surface that decimation took something from; returns facts, or why there is none.
    """
    surface = Surface.of(atlas / "mesh_uv.ply")
    low = surface.geometry
    why = _why_none(mesh / DENSE, low, settings)
    if why:
        return {"normal_map": why}

    dense = load_mesh(mesh / DENSE)
    normals, facts = bake(low, dense, settings.resolution, settings.padding)
    if facts["tilt_95"] < LEAST_TILT:
        why = f"none: decimation moved normals by less than {LEAST_TILT} degrees"
        return {"normal_map": f"{why} at 95 % of the texels"}
    path = surface.with_normals(normals).normal_map
    assert path is not None  # it was written
    return {
        "normal_map": f"what decimation took from {len(dense.faces)} triangles",
        "normal_map_found_share": facts["found_share"],
        "normal_map_median_tilt": facts["median_tilt"],
        "normal_map_mib": round(path.stat().st_size / 2**20, 2),
    }


def _why_none(dense: Path, low: Mesh, settings: Atlas) -> str | None:
    """Why there can be no normal map, or None where there can."""
    if not settings.normal_map:
        return "none: atlas.normal_map is off"
    if not dense.exists():
        return "none: the mesh was given, nothing was taken from it"

    mirrored = mirrored_share(low)
    if mirrored > MIRRORED:
        return f"none: the atlas mirrors {100 * mirrored:.0f} % of its area"
    return None
