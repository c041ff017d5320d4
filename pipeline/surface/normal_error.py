"""How far the normals of a mesh that is made from photos are off, per axis."""

from __future__ import annotations

import numpy as np

# median length of two deviates of deviation 1
MEDIAN_LENGTH = np.sqrt(2 * np.log(2))
# the mesh stage's estimate may be off by such a factor (its deviation, in logs)
UNSURE = 1.5


def per_axis(normal_error: float) -> float:
    """Deviation of normals per axis from the median angle of their errors, radians both."""
    return normal_error / MEDIAN_LENGTH
