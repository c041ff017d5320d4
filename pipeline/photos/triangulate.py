"""Points of a scene whose cameras are given: matched like those of structure from motion, and
triangulated where the cameras say.

Asked where no photo has a mask: the ground plane that masks are found against is sought among them.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pipeline.base.config import Poses
from pipeline.geometry.cameras import View
from pipeline.photos.sfm import SEED, extract_each, match_given, sparse_points, write_matched

if TYPE_CHECKING:
    import pycolmap


def triangulated(views: list[View], folder: Path, settings: Poses, threads: int) -> dict:
    """Sparse points (`points.npz`) that the views (undistorted, pictures in `folder`) which are not
    held out have in common, in the world of their cameras.
    """
    import pycolmap

    pycolmap.logging.minloglevel = 2
    pycolmap.set_random_seed(SEED)
    with tempfile.TemporaryDirectory(prefix="heliograph-points-") as temporary:
        work = Path(temporary)
        told = {k: v for k, v in enumerate(views) if v.split == "fit"}
        files = {}
        small = {}
        for k, view in told.items():
            files[k] = f"{k:05d}.jpg"
            small[k] = write_matched(folder / view.image, view, work / files[k], settings.max_size)

        database = work / "matched.db"
        extract_each(database, work, settings, threads)
        model = _with_cameras(database, {files[k]: small[k] for k in told})
        match_given(database, len(told), settings, threads)
        options = pycolmap.IncrementalPipelineOptions()
        options.num_threads = threads
        options.random_seed = SEED
        (work / "model").mkdir()
        model = pycolmap.triangulate_points(model, database, work, work / "model", options=options)

    place = {files[k]: k for k in told}
    order = {i.image_id: place[i.name] for i in model.images.values()}
    return sparse_points(model, order, {})


def _with_cameras(database: Path, views: dict[str, View]) -> pycolmap.Reconstruction:
    """A model without points: the database's images with the lens and the pose of `views`, by file
    name. The database has the lenses too from then on.
    """
    import pycolmap

    model = pycolmap.Reconstruction()
    with pycolmap.Database.open(str(database)) as db:
        for image in db.read_all_images():
            view = views[image.name]
            camera = pycolmap.Camera(
                model="PINHOLE",
                width=view.width,
                height=view.height,
                params=[view.fx, view.fy, view.cx, view.cy],
                camera_id=image.camera_id,
                has_prior_focal_length=True,
            )
            db.update_camera(camera)
            model.add_camera_with_trivial_rig(camera)
            keypoints = np.asarray(db.read_keypoints(image.image_id))[:, :2].astype(float)
            posed = pycolmap.Image(
                name=image.name,
                keypoints=keypoints,
                camera_id=image.camera_id,
                image_id=image.image_id,
            )
            pose = pycolmap.Rigid3d(view.world_to_camera[:3])
            model.add_image_with_trivial_frame(posed, pose)
    return model
