"""Photos that are kept for scoring: which they are, and where they were taken.

No stage learns anything from them: a held-out photo's camera is found from the points that the
others have made, its gain from their brightness there, its mask from the finished surface, unless
the user gave them. cameras.json says of every view what it is for (`View.split`).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from scipy.sparse.csgraph import connected_components

from pipeline.base.config import Observe

if TYPE_CHECKING:
    import pycolmap

FEWEST_MATCHES = 15  # points that a pose found from them must agree with
# points in common that connect two photos: as many as mapping needs, up to safely more
CONNECTIONS = 15, 30, 60, 120
# points in common with one other photo at least, by which a photo is placed to about a pixel:
# with 41, 45 and 52 three were off by .9, 9.8 and 1.0 pixels, with 81 and more by .04 to .45
WELL_PLACED = 60


def hold_out(
    photos: list[dict], settings: Observe, matches: np.ndarray | None = None
) -> list[dict]:
    """The photos (photos.json) with those held out marked: `split` "test". The scene's own test
    photos, else a random share of all (at least one from 8 photos on).

    matches (n, n): how many points photos have in common. A photo without which the others no
    longer hang together stays with them, and another one is held out in its place; with few
    connections fewer are. Those that would be placed badly, and so score what they do not show, are
    held out last.
    """
    names = [p["name"] for p in photos if p["split"] == "fit"]
    if len(names) < len(photos) or settings.held_out == 0:
        return photos

    least = 1 if len(names) >= 8 else 0
    count = max(round(settings.held_out * len(names)), least)
    rng = np.random.default_rng(0)
    first = rng.choice(len(names), count, replace=False)
    others = rng.permutation(np.setdiff1d(np.arange(len(names)), first))
    candidates = [int(k) for k in (*first, *others)]
    if matches is None:
        out = candidates[:count]
    else:
        candidates.sort(key=lambda k: bool(matches[k].max() < WELL_PLACED))
        out = spared(matches, candidates, count)
    chosen = {names[k] for k in out}
    return [p | {"split": "test" if p["name"] in chosen else "fit"} for p in photos]


def spared(matches: np.ndarray, candidates: list[int], count: int) -> list[int]:
    """The first `count` of the candidates without which the other photos make no more groups than
    all photos do, whatever number of CONNECTIONS connects two. matches (n, n).
    """
    everyone = np.arange(len(matches))
    most = groups(matches)
    out: list[int] = []
    for one in candidates:
        if len(out) == count:
            break
        rest = np.setdiff1d(everyone, [*out, one])
        if (groups(matches[np.ix_(rest, rest)]) <= most).all():
            out.append(one)
    return out


def groups(matches: np.ndarray) -> np.ndarray:
    """Into how many groups photos fall where so many of CONNECTIONS connect two."""
    return np.array([connected_components(matches >= least)[0] for least in CONNECTIONS])


def matches_between(database: Path, files: list[str]) -> np.ndarray:
    """How many points two images have in common, by COLMAP's verified matches: (n, n) in the order
    of their names `files`.
    """
    import pycolmap

    out = np.zeros((len(files), len(files)), int)
    with pycolmap.Database.open(str(database)) as db:
        number = {image.name: image.image_id for image in db.read_all_images()}
        ids = [number[file] for file in files]
        for k, one in enumerate(ids):
            for j, other in enumerate(ids[:k]):
                if db.exists_two_view_geometry(one, other):
                    common = db.read_two_view_geometry(one, other).inlier_matches
                    out[k, j] = out[j, k] = len(common)
    return out


@dataclass
class Placed:
    """A photo placed by the points of others: its camera, world-to-camera, and the numbers of those
    points.
    """

    camera: pycolmap.Camera
    pose: pycolmap.Rigid3d
    points: list[int]


def without_matches(database: Path, copy: Path, files: Iterable[str]) -> None:
    """A copy of COLMAP's database in which the images called `files` match no other."""
    import pycolmap

    copy.write_bytes(database.read_bytes())
    with pycolmap.Database.open(str(copy)) as db:
        ids = {image.name: image.image_id for image in db.read_all_images()}
        left_out = [ids[file] for file in files]
        for a in left_out:
            for b in ids.values():
                if a != b and db.exists_matches(a, b):
                    db.delete_matches(a, b)
                if a != b and db.exists_two_view_geometry(a, b):
                    db.delete_two_view_geometry(a, b)


def place(
    database: Path, model: pycolmap.Reconstruction, files: Iterable[str]
) -> dict[str, Placed]:
    """Cameras of images that are in the database and not in the model, by the model's points that
    they match; images that match too few are left out. The lens is the model's where photos of it
    share one, else it is refined from what EXIF says.
    """
    import pycolmap

    out = {}
    with pycolmap.Database.open(str(database)) as db:
        known = {other.camera_id for other in model.images.values() if other.has_pose}
        by_name = {image.name: image for image in db.read_all_images()}
        for file in files:
            image = by_name[file]
            pixel, point = _matched_points(db, model, image.image_id)
            shared = image.camera_id in known
            camera = model.cameras[image.camera_id] if shared else db.read_camera(image.camera_id)
            refine = pycolmap.AbsolutePoseRefinementOptions()
            refine.refine_focal_length = not shared
            refine.refine_extra_params = not shared
            if len(point) < FEWEST_MATCHES:
                continue
            xyz = np.array([model.points3D[p].xyz for p in point])
            found = pycolmap.estimate_and_refine_absolute_pose(
                pixel, xyz, camera, refinement_options=refine
            )
            if found is None or found["num_inliers"] < FEWEST_MATCHES:
                continue
            agree = np.asarray(found["inlier_mask"])
            seen = sorted({int(p) for p, good in zip(point, agree) if good})
            out[file] = Placed(camera, found["cam_from_world"], seen)
    return out


def _matched_points(
    db: pycolmap.Database, model: pycolmap.Reconstruction, image: int
) -> tuple[np.ndarray, list[int]]:
    """Pixels (n, 2) of an image and the model's points that they show: those of the keypoints that
    they match in the model's images. Of several points for one keypoint, all.
    """
    keypoints = np.asarray(db.read_keypoints(image))[:, :2]
    pairs = set()
    for other in model.images.values():
        if not other.has_pose or not db.exists_two_view_geometry(image, other.image_id):
            continue
        matches = db.read_two_view_geometry(image, other.image_id).inlier_matches
        for mine, theirs in np.asarray(matches):
            at = other.points2D[theirs]
            if at.has_point3D():
                pairs.add((int(mine), int(at.point3D_id)))
    ordered = sorted(pairs)
    return keypoints[[k for k, _ in ordered]].reshape(-1, 2), [p for _, p in ordered]
