"""Cameras of a scene: given or by structure from motion; upright, near the origin; undistorted
photos.

Frame after this stage: right-handed, Y-up. For structure from motion the ground plane is y = 0, the
object's axis passes through the origin and its diameter is `poses.object_size` metres (1 where
unknown). Given cameras keep their own world.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from pipeline.base.config import Observe, Poses
from pipeline.base.errors import InputError
from pipeline.base.files import read_json
from pipeline.geometry.cameras import Rig, View, save_cameras
from pipeline.geometry.mesh_io import unit
from pipeline.photos.colmap_model import model_folder
from pipeline.photos.colmap_world import given_model, reconstructed
from pipeline.photos.given_world import ground_of_given, posed_by_file
from pipeline.photos.held_out import hold_out
from pipeline.photos.library_frame import upright
from pipeline.photos.photometry import gains, match_exposure, point_brightness
from pipeline.photos.posed import PosedPhotos
from pipeline.photos.scene_files import camera_file
from pipeline.photos.sfm import HINT
from pipeline.photos.triangulate import triangulated
from pipeline.photos.turntable import check, light_motion
from pipeline.photos.undistort import write_views


def _photometry(
    views: list[View],
    out: Path,
    points: dict,
    sphere: tuple[np.ndarray, float],
    scene: Path,
    settings: Poses,
    captured: dict,
) -> tuple[list[View], dict]:
    """What matched points say of light that moves with the camera (facts, `warnings` among them, or
    InputError), and of the photos' gains, which are divided out of the pictures under `out`. Views
    and facts. sphere: the object's centre and radius; captured: what photos.json says.
    """
    brightness = point_brightness(views, out, points)
    fit = np.array([v.split == "fit" for v in views])
    stops = gains(brightness, fit)
    green = brightness.of_views(fit).channel(1).less(stops[fit, 1])
    told = [v for v in views if v.split == "fit"]
    motion = light_motion(told, green, points["xyz"], *sphere)
    accept = settings.moving_light == "accept"
    facts: dict = {
        "light_motion": motion.facts(),
        "warnings": check(motion, str(scene), accept, captured.get("out_of_focus", [])),
    }
    if settings.match_exposure:
        known_from = None
        if captured.get("exposure_known"):  # not told by earlier versions
            known_from = unit(np.stack([v.position - sphere[0] for v in views]))
        views, matched = match_exposure(views, out, stops, known_from)
        facts |= matched
    return views, facts


def _posed(
    capture: Path,
    scene: Path,
    photos: list[dict],
    settings: Poses,
    held_out: Observe,
    threads: int,
) -> tuple[list[dict], PosedPhotos]:
    """The photos, each with its `split`, and those of them that have a camera: of the scene's
    transforms file, of its COLMAP model, or by structure from motion.
    """
    file = camera_file(scene)
    if file:
        photos = hold_out(photos, held_out)
        return photos, posed_by_file(file, scene, photos)

    folder = model_folder(scene)
    if folder is not None:
        mapped, facts = given_model(folder, photos)
        known = hold_out([p for p in photos if p["name"] in mapped.found], held_out)
        photos = known + [p for p in photos if p["name"] not in mapped.found]
    else:
        photos, mapped, facts = reconstructed(capture, photos, settings, held_out, threads)
    posed = upright(mapped, photos, capture, settings)
    return photos, replace(posed, facts=facts | posed.facts)


def make_poses(
    capture: Path, scene: Path, out: Path, settings: Poses, held_out: Observe, threads: int
) -> dict:
    """Write cameras.json, images/, masks/ and points.npz into `out`; returns metrics. held_out:
    says which photos are kept for scoring (`hold_out`), of which no stage learns anything.

    Raises InputError when cameras are unusable or photos do not connect.
    """
    captured = read_json(capture / "photos.json")
    photos, posed = _posed(capture, scene, captured["photos"], settings, held_out, threads)
    kept = posed.photos
    if sum(p["split"] == "fit" for p in kept) < 3:
        raise InputError(f"only {len(kept)} photos have a camera", scene, HINT)

    lenses = [lens.at(p["width"], p["height"]) for lens, p in zip(posed.lenses, kept)]
    with_camera = {p["name"] for p in kept}
    unregistered = [p["name"] for p in photos if p["name"] not in with_camera]
    out_of_focus = captured.get("out_of_focus", [])  # not told by earlier versions
    facts = posed.facts | {"unregistered": unregistered, "out_of_focus": out_of_focus}
    views = write_views(capture, out, kept, lenses, posed.poses)

    center, radius, points = posed.center, posed.radius, posed.points
    masked = any(p["has_mask"] for p in kept if p["split"] == "fit")
    if camera_file(scene) and not masked:
        points = triangulated(views, out, settings, threads)
        center, radius, ground = ground_of_given(points["xyz"], views, center, radius)
        facts |= ground
    elif len(points["xyz"]):
        sphere = center, radius
        views, seen = _photometry(views, out, points, sphere, scene, settings, captured)
        facts |= seen

    np.savez_compressed(out / "points.npz", **points)
    save_cameras(out / "cameras.json", Rig(views, center, radius, facts["source"], facts))
    return {
        "registered": len(kept),
        "held_out": [p["name"] for p in kept if p["split"] == "test"],
        "photos": len(photos),
        "points": len(points["xyz"]),
        "radius": radius,
    } | facts
