"""Whole pictures for the tests; the pipeline traces the pixels of a mask only."""

import numpy as np

from pipeline.geometry.cameras import View
from pipeline.render.metrics import render_pixels
from pipeline.render.renderer import Explanation, Renderer


def render_view(
    renderer: Renderer, explanation: Explanation, view: View, spp: int, seed: int = 0
) -> np.ndarray:
    """Picture (h, w, 3) of the object on black."""
    everywhere = np.ones((view.height, view.width), bool)
    return render_pixels(renderer, explanation, view, everywhere, spp, seed)
