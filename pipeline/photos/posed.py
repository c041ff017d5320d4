"""Photos with their cameras and the object's place: what the ways to find cameras hand on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pipeline.photos.given_cameras import Lens


@dataclass(frozen=True)
class PosedPhotos:
    """photos: those of photos.json that have a camera; lenses, poses: of each, poses are
    world-to-camera (4, 4); center (3,), radius: of the sphere that the object lies in; points: what
    points.npz holds (`sfm.sparse_points`); facts: what cameras.json says of the way here. In the
    library frame.
    """

    photos: list[dict]
    lenses: list[Lens]
    poses: list[np.ndarray]
    center: np.ndarray
    radius: float
    points: dict
    facts: dict
