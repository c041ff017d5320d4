"""Are all photos out of focus? selection.py holds photos against each other and cannot see it.

Where something is in focus, the steepest edges of a photo are as narrow as its optics and its
pixels allow; edges of what lies before or behind are wider, and blur widens all of them. The width
of an edge is the range of brightness around it over the gradient on it. Figures of development
data, six sets of real photos at 1000 pixels, median over a set's photos: 2.9 to 3.8 pixels as they
are, 10 to 11 after a Gaussian of 4 pixels, 19 to 20 after one of 8; of a made one (256 pixels) 2.5,
and 4.3, 5.3 and 9.5 after Gaussians of 1.5, 2 and 4.
"""

from __future__ import annotations

import cv2
import numpy as np

STEEPEST = 10  # percentile of the widths: edges of what is in focus, if anything is
AROUND = 0.05  # of the long side: how far around an edge its range is sought
LEAST_AROUND = 8  # pixels
STRONG = 0.5  # of the photo's strong ranges (95th percentile), from which an edge counts
WIDE = 6  # pixels: out of focus by a Gaussian of some 2.3


def edge_width(grey: np.ndarray) -> float:
    """Width in pixels of the steepest edges of a grey picture (h, w), after a slight blur against
    noise; inf where there is no edge.
    """
    smooth = cv2.GaussianBlur(grey.astype(np.float32), (0, 0), 0.7)
    across = cv2.Sobel(smooth, cv2.CV_32F, 1, 0, scale=1 / 8)
    down = cv2.Sobel(smooth, cv2.CV_32F, 0, 1, scale=1 / 8)
    gradient = np.hypot(across, down)

    reach = max(LEAST_AROUND, round(AROUND * max(grey.shape)))
    square = np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)
    contrast = cv2.dilate(smooth, square) - cv2.erode(smooth, square)
    strong = contrast > STRONG * np.percentile(contrast, 95)
    edge = strong & (gradient >= cv2.dilate(gradient, square)) & (gradient > 0)
    if not edge.any():
        return float("inf")
    return float(np.percentile(contrast[edge] / gradient[edge], STEEPEST))


def said_of_focus(widths: list[float]) -> list[str]:
    """A warning, or none. widths: of each photo's edges, in pixels of a picture with at most 1000
    (selection.LARGE).
    """
    width = float(np.median(widths))
    if not WIDE < width < np.inf:
        return []
    return [
        f"the photos are out of focus, or blurred: their steepest edges are {width:.0f} pixels "
        f"wide (in focus: below {WIDE}). Shape, gloss and light come out wrong"
    ]
