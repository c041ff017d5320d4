"""A COLMAP model, the user's or from structure from motion, matched to the scene's photos."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pipeline.base.config import Observe, Poses
from pipeline.photos.colmap_model import names_of, read_model
from pipeline.photos.given_cameras import (
    Lens,
    check_shape,
    lens_of_colmap,
    pose_of_colmap,
    poses_of_model,
    turned_right,
)
from pipeline.photos.sfm import on_its_side, reconstruct

if TYPE_CHECKING:
    import pycolmap


@dataclass
class Mapped:
    """COLMAP's world: the model, its image name -> photo name, lens and world-to-camera (4, 4) per
    photo name, and the model's points that a photo shows which was placed by them, per photo name.
    """

    model: pycolmap.Reconstruction
    names: dict[str, str]
    found: dict[str, tuple[Lens, np.ndarray]]
    placed: dict[str, list[int]]

    def lenses_of(self, photos: list[dict]) -> list[Lens]:
        """The lens of each photo."""
        return [self.found[p["name"]][0] for p in photos]

    def poses_of(self, photos: list[dict]) -> list[np.ndarray]:
        """The pose of each photo."""
        return [self.found[p["name"]][1] for p in photos]


def _model_of(
    folder: Path, photos: list[dict]
) -> tuple[pycolmap.Reconstruction, dict[str, str], dict[str, tuple[Lens, np.ndarray]]]:
    """The COLMAP model in `folder`: model, its image name -> photo name, and lens and pose per
    photo name.

    Raises InputError for an unreadable model, or one that was not made from these photos.
    """
    model = read_model(folder)
    names = names_of(photos, model, folder)
    found = poses_of_model(model, names)
    sizes = {p["name"]: p["original_size"] for p in photos}
    for name, (lens, _) in found.items():
        check_shape(lens.width, lens.height, sizes[name], folder, name)
    return model, names, found


def given_model(folder: Path, photos: list[dict]) -> tuple[Mapped, dict]:
    """A given model and facts. Photos that are held out stand where the model has them."""
    model, names, found = _model_of(folder, photos)
    facts = {
        "source": "colmap",
        "reprojection_error_px": model.compute_mean_reprojection_error(),
    }
    return Mapped(model, names, found, {}), facts


def reconstructed(
    capture: Path, photos: list[dict], settings: Poses, observe: Observe, threads: int
) -> tuple[list[dict], Mapped, dict]:
    """The photos with their `split`; structure from motion of those that are not held out, with the
    others placed by it; and facts.
    """
    model, names, placed, attempts, photos = reconstruct(
        capture, photos, settings, observe, threads
    )
    found = poses_of_model(model, names)
    for file, one in placed.items():
        found[names[file]] = lens_of_colmap(one.camera), pose_of_colmap(one.pose, file)
    for p in photos:
        if p["name"] in found and on_its_side(p, photos):  # undo `write_inputs`
            found[p["name"]] = turned_right(*found[p["name"]])
    facts = {
        "source": "sfm",
        "attempts": attempts,
        "reprojection_error_px": model.compute_mean_reprojection_error(),
    }
    sights = {names[file]: one.points for file, one in placed.items()}
    return photos, Mapped(model, names, found, sights), facts


def sightings(mapped: Mapped, kept: list[dict]) -> tuple[dict[int, int], dict[int, list[int]]]:
    """The model's image number -> index in `kept`, of photos that are not held out; and number of a
    point -> indices of held-out photos that show it.
    """
    index = {p["name"]: k for k, p in enumerate(kept)}
    order = {}
    others: dict[int, list[int]] = {}
    for image in mapped.model.images.values():
        at = index.get(mapped.names.get(image.name, ""))
        if at is None:
            continue
        if kept[at]["split"] == "fit":
            order[image.image_id] = at
            continue
        for point in image.points2D:
            if point.has_point3D():
                others.setdefault(point.point3D_id, []).append(at)
    for name, points in mapped.placed.items():
        for number in points:
            others.setdefault(number, []).append(index[name])
    return order, others
