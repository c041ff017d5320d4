"""Which colours are the object's and which its surroundings', learned from pixels whose side is
known.

Histograms of CIELAB, lightness in steps of 5 and hue in steps of 4, smoothed by one step.
"""

from __future__ import annotations

import numpy as np
from scipy import ndimage

BINS = (21, 40, 40)  # lightness 0..105, a and b -80..80
STEPS = np.array([5, 4, 4], np.float32)
LOW = np.array([0, -80, -80], np.float32)
FEWEST = 500  # pixels of each side that a model is made from


def bins(lab: np.ndarray) -> np.ndarray:
    """Index (...) of the bin that each colour (..., 3) falls into."""
    at = ((lab - LOW) / STEPS).astype(np.int64)
    return np.ravel_multi_index(tuple(np.moveaxis(at, -1, 0)), BINS, mode="clip")


class Colours:
    """Log-ratio of the colours' densities on the object and around it."""

    def __init__(
        self,
        labs: dict[str, np.ndarray],
        object_pixels: dict[str, np.ndarray],
        other_pixels: dict[str, np.ndarray],
        limit: float,
    ):
        """labs: photos; object_pixels, other_pixels: bool (h, w) for the photos to learn from;
        limit: largest log-odds that a colour may claim.
        """
        self.limit = limit
        inside = self._counts(labs, object_pixels)
        outside = self._counts(labs, other_pixels)
        self.known = min(inside.sum(), outside.sum()) >= FEWEST
        self.ratio = np.zeros(int(np.prod(BINS)), np.float32)
        if self.known:
            self.ratio = self._log_ratio(inside, outside)

    @staticmethod
    def _counts(labs: dict[str, np.ndarray], pixels: dict[str, np.ndarray]) -> np.ndarray:
        total = np.zeros(int(np.prod(BINS)))
        for name, chosen in pixels.items():
            total += np.bincount(bins(labs[name][chosen]), minlength=len(total))
        return total

    def _log_ratio(self, inside: np.ndarray, outside: np.ndarray) -> np.ndarray:
        """Of the smoothed densities; a colour that neither has shown claims nothing."""
        smooth = lambda counts: ndimage.gaussian_filter(counts.reshape(BINS) / counts.sum(), 1.0)
        floor = 1e-5
        ratio = np.log((smooth(inside) + floor) / (smooth(outside) + floor))
        return np.clip(ratio, -self.limit, self.limit).astype(np.float32).ravel()

    def odds(self, lab: np.ndarray) -> np.ndarray:
        """Log-odds (h, w) that a pixel shows the object, in [-limit, limit]."""
        return self.ratio[bins(lab)]
