"""Saturated pixels from capture to observations: judged at the photo's full resolution, scaled and
undistorted along with it.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pipeline.base.images import read_png
from pipeline.geometry.cameras import View

NEAR_LEVEL = 0.98  # share of a view's clip level from which a pixel counts as saturated


def saturated(folder: Path, view: View, photo: np.ndarray) -> np.ndarray:
    """Which channels of which pixels (h, w, 3) of the linear `photo` (h, w, 3) are lower bounds
    only.

    folder: where the view's pictures lie (the poses stage's). Views without a picture of their
    saturated pixels were not captured from files; they are held against the clip level.
    """
    if view.saturated is None:
        return photo >= NEAR_LEVEL * view.clip_level
    return read_png(folder / view.saturated) > 127
