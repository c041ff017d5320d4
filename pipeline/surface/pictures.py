"""Photos and views at a part of their size."""

from __future__ import annotations

import cv2
import numpy as np

from pipeline.geometry.cameras import View


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
