"""Cameras from transforms files, which keep their own world."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pipeline.geometry.cameras import Y_FROM_Z_UP, View
from pipeline.photos.given_cameras import read_transforms
from pipeline.photos.ground_plane import NoGround, ground_plane
from pipeline.photos.object_sphere import MARGIN, object_points, object_sphere
from pipeline.photos.posed import PosedPhotos
from pipeline.photos.sfm import SEED, no_points
from pipeline.photos.viewpoints import axes_meeting_point, middle_and_distance, positions

MOST_TILTED = 3.0  # degrees by which the ground may be out of level in the world of given cameras


def posed_by_file(file: Path, scene: Path, photos: list[dict]) -> PosedPhotos:
    """The photos that `file`, a transforms file, or the scene's transforms_test.json has a camera
    for. The object is taken to lie where the optical axes meet.

    Raises InputError for a file that cannot be read, or a frame whose photo was not captured.
    """
    sizes = {p["name"]: tuple(p["original_size"]) for p in photos}
    found = read_transforms(file, scene, sizes)
    if (scene / "transforms_test.json").exists():
        found |= read_transforms(scene / "transforms_test.json", scene, sizes)

    kept = [p for p in photos if p["name"] in found]
    center, distance = middle_and_distance(
        [found[p["name"]][1] for p in kept if p["split"] == "fit"]
    )
    return PosedPhotos(
        photos=kept,
        lenses=[found[p["name"]][0] for p in kept],
        poses=[found[p["name"]][1] for p in kept],
        center=center,
        radius=0.5 * float(distance),
        points=no_points(),
        facts={
            "source": "transforms.json",
            "up": "the cameras' own world",
            "plane": None,
            "world": Y_FROM_Z_UP,
        },
    )


def ground_of_given(
    xyz: np.ndarray, views: list[View], center: np.ndarray, radius: float
) -> tuple[np.ndarray, float, dict]:
    """The ground in the world of given cameras, which is y = height there or not at all, and the
    object's sphere above it: centre, radius and facts. Without such a ground the sphere stays.
    """
    told = [v.world_to_camera for v in views if v.split == "fit"]
    middle = axes_meeting_point(told)
    up = np.array([0.0, 1.0, 0.0])
    plane = ground_plane(xyz, positions(told), up, middle, SEED)
    if isinstance(plane, NoGround):
        return center, radius, {"ground": plane.why} | plane.facts()

    tilt = float(np.degrees(np.arccos(np.clip(plane.normal @ up, -1, 1))))
    if tilt > MOST_TILTED:
        tilted = NoGround(
            f"the plane among the matched points is tilted by {tilt:.1f} degrees against the "
            "cameras' own up, +Z in their file",
            "export the cameras with the table level",
        )
        return center, radius, {"ground": tilted.why} | tilted.facts()

    center, radius, how = object_sphere(object_points(xyz, told, [], plane, None), told, plane)
    normal = plane.normal
    height = (plane.offset - normal[0] * center[0] - normal[2] * center[2]) / normal[1]
    facts = {"normal": up, "offset": float(height), "inlier_share": plane.inlier_share}
    return center, MARGIN * radius, {"plane": facts, "ground": "found", "object_found_by": how}
