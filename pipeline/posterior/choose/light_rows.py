"""Rows of the light: no more than reflections over normals in error can tell apart.

Normals with an error of sigma per axis (radians) turn a mirror's direction by 2 sigma: reflections
are the light blurred by a Gaussian of that width, which leaves exp(-(2 sigma l)^2 / 2) of a detail
of l periods around the sphere. h rows over pi hold details up to l = h. Any material shows less of
the light than a mirror does; shadows show more, of what is small and bright.
"""

from __future__ import annotations

import numpy as np

VISIBLE = 0.05  # part of a detail's contrast that can still be told from a picture's own error
COARSEST = 16  # rows: shadows resolve a sun better than blurred reflections do


def rows_told_apart(normal_spread: float) -> float:
    """Rows h with exp(-(2 sigma h)^2 / 2) = VISIBLE, for normals in error by sigma, `normal_spread`
    per axis, radians; infinite where there is no error.
    """
    if normal_spread == 0:
        return np.inf
    return float(np.sqrt(2 * np.log(1 / VISIBLE)) / (2 * normal_spread))


def light_rows(normal_spread: float, most: int) -> tuple[int, dict]:
    """Rows of the operator's light, and the evidence: the fewest that reflections need, COARSEST at
    least, of those that divide `most` as `most` divides the prior's.
    """
    needed = rows_told_apart(normal_spread)
    possible = [h for h in range(COARSEST, most) if most % h == 0 and h >= needed]
    return min([*possible, most]), {
        "normal_spread_radians": normal_spread,
        "rows_told_apart": needed if np.isfinite(needed) else None,
        "visible_contrast": VISIBLE,
    }
