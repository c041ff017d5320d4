"""Photos and views at a part of their size."""

from __future__ import annotations

import cv2
import numpy as np

from pipeline.geometry.cameras import View
from pipeline.geometry.mesh_io import Mesh
from pipeline.surface.zbuffer import Crop


def at_size(view: View, image: np.ndarray) -> View:
    """The view at the size of its image (h, w), whose sides may be rounded. Raises ValueError for
    an image of other proportions.
    """
    h, w = image.shape
    if abs(w * view.height - h * view.width) > max(view.width, view.height):
        raise ValueError(f"an image of {w} x {h} pixels is no reduced picture of {view.name}")
    return view.at_size(w, h)


def reduced(image: np.ndarray, factor: float) -> np.ndarray:
    """The image (h, w) at `factor` times its size, at most its own."""
    image = image.astype(np.float32)
    if factor >= 1:
        return image
    h, w = image.shape
    size = (max(1, round(w * factor)), max(1, round(h * factor)))
    return cv2.resize(image, size, interpolation=cv2.INTER_AREA)


def mask_like(mask: np.ndarray, picture: np.ndarray) -> np.ndarray:
    """The mask (bool) at the picture's size; a pixel is in it where all that it stands for is."""
    h, w = picture.shape
    return cv2.resize(mask.astype(np.float32), (w, h), interpolation=cv2.INTER_AREA) > 0.99


def affordable(mesh: Mesh, views: list[View], images: list[np.ndarray], pixels: float) -> float:
    """Factor by which the images must be reduced for the boxes around the mesh to hold no more than
    `pixels` in all; at most 1.
    """
    boxes = (Crop.around(at_size(v, i), mesh.vertices, 0) for v, i in zip(views, images))
    total = sum(float(box.width) * box.height for box in boxes)
    return min(1.0, (pixels / total) ** 0.5)
