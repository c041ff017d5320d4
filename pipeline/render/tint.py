"""Tints: what a colour is beside its brightness."""

from __future__ import annotations

import numpy as np

# orthonormal directions of log linear Rec.709: warm against cold, green against magenta
TINTS = np.array([[1, 0, -1], [-1, 2, -1]]) / np.sqrt([[2], [6]])


def tint_of(color: np.ndarray) -> np.ndarray:
    """(..., 2) of colours or radiance (..., 3), positive: along TINTS, 0 where all is grey."""
    return np.log(color) @ TINTS.T
