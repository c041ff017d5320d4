"""From COLMAP's world, which has neither up nor size, to the library frame."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from pipeline.base.config import Poses
from pipeline.base.images import read_png
from pipeline.photos.colmap_world import Mapped, sightings
from pipeline.photos.ground_plane import NoGround, Plane, ground_plane
from pipeline.photos.object_sphere import MARGIN, object_points, object_sphere
from pipeline.photos.posed import PosedPhotos
from pipeline.photos.sfm import SEED, sparse_points
from pipeline.photos.viewpoints import axes_meeting_point, mean_up, positions


def rotation_to_y(up: np.ndarray) -> np.ndarray:
    """Rotation (3, 3) that takes the unit vector `up` (3,) to +Y by the shortest way."""
    return Rotation.align_vectors([0, 1, 0], up)[0].as_matrix()


def similarity(
    pose: np.ndarray, rotation: np.ndarray, shift: np.ndarray, scale: float
) -> np.ndarray:
    """World-to-camera for the new world x' = scale (R x) + shift."""
    out = np.eye(4)
    out[:3, :3] = pose[:3, :3] @ rotation.T
    out[:3, 3] = scale * pose[:3, 3] - out[:3, :3] @ shift
    return out


def upright(mapped: Mapped, photos: list[dict], capture: Path, settings: Poses) -> PosedPhotos:
    """Turn, shift and scale a COLMAP world so that +Y is up and the object lies at the origin.
    Photos that are held out are moved along and say nothing.
    """
    kept = [p for p in photos if p["name"] in mapped.found]
    told = [p for p in kept if p["split"] == "fit"]
    points = sparse_points(mapped.model, *sightings(mapped, kept))
    poses = mapped.poses_of(told)
    up = mean_up(poses)
    found = ground_plane(points["xyz"], positions(poses), up, axes_meeting_point(poses), SEED)
    plane = found if isinstance(found, Plane) else None
    center, radius, how = _object_of(points["xyz"], mapped, told, plane, capture)

    rotation, shift, scale = _to_library_frame(plane, up, center, radius, settings)
    return PosedPhotos(
        photos=kept,
        lenses=mapped.lenses_of(kept),
        poses=[similarity(p, rotation, shift, scale) for p in mapped.poses_of(kept)],
        center=scale * rotation @ center + shift,
        radius=MARGIN * scale * radius,
        points=points | {"xyz": scale * points["xyz"] @ rotation.T + shift},
        facts=_frame_facts(found, how, rotation, shift, scale),
    )


def _object_of(
    xyz: np.ndarray, mapped: Mapped, told: list[dict], plane: Plane | None, capture: Path
) -> tuple[np.ndarray, float, str]:
    """The object's sphere in COLMAP's world (`object_sphere`), by the masks that lie in `capture`
    if every photo of `told` has one.
    """
    lenses = mapped.lenses_of(told)
    poses = mapped.poses_of(told)
    if not all(p["has_mask"] for p in told):
        return object_sphere(object_points(xyz, poses, lenses, plane, None), poses, plane)

    masks = [read_png(capture / "masks" / f"{p['name']}.png") for p in told]
    return object_sphere(object_points(xyz, poses, lenses, plane, masks), poses, None)


def _to_library_frame(
    plane: Plane | None, up: np.ndarray, center: np.ndarray, radius: float, settings: Poses
) -> tuple[np.ndarray, np.ndarray, float]:
    """Rotation, shift and scale of x' = scale (R x) + shift: the ground becomes y = 0, the object
    has the wanted size and stands above the origin.
    """
    normal = plane.normal if plane is not None else up
    rotation = rotation_to_y(normal) if settings.up == "auto" else np.eye(3)
    scale = (settings.object_size or 1.0) / (2 * radius)

    shift = -scale * (rotation @ center)
    if settings.up == "auto":
        ground = plane.offset if plane is not None else normal @ center - radius
        shift[1] = -scale * ground
    return rotation, shift, scale


def _frame_facts(
    found: Plane | NoGround, how: str, rotation: np.ndarray, shift: np.ndarray, scale: float
) -> dict:
    """What cameras.json says of the change of frame, and of `how` the object was found."""
    world = np.eye(4)
    world[:3, :3] = scale * rotation
    world[:3, 3] = shift

    facts = {"object_found_by": how, "plane": None, "world": world}
    if isinstance(found, NoGround):
        return {"up": "mean camera up (no ground plane found)"} | facts | found.facts()

    normal = rotation @ found.normal
    turned = {
        "normal": normal,
        "offset": scale * found.offset + shift @ normal,
        "inlier_share": found.inlier_share,
    }
    return {"up": "ground plane"} | facts | {"plane": turned}
