"""Where depth earns its place: elsewhere the hull, drawn taut, stands in for the fused surface.

Depth of what is glossy lies behind the surface, and depth maps agree on it, for the picture that it
mirrors moves little from one photo to the next. So the fused surface is carved in part, and often
fills the masks all the same. But where depth is right it predicts photos that were left out much
better than the hull does, and where it mirrors a little better or not at all. What it has to save
there hangs on how much of the thing's depth masks prove wrong (filling.py): of a thing that
mirrors nowhere the hull is the worse guess, for masks close its gaps and hold ground.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from pipeline.geometry.mesh_io import Mesh

# share of the hull's error that depth has to save around a point, of a thing whose depth is mostly
# bad. On things with known surfaces .1 to .3 do about as well as each other, but on two that mirror
# all over (F-score at 1 % before refinement at .1 | .2: .520 | .549, .699 | .740)
WORTH_AROUND = 0.2
# shares of depth that masks prove wrong, up to which nothing is asked of the rest, and from which
# on WORTH_AROUND is. At most .021 on five things: WORTH_AROUND would cost two of them .12 and
# .01 of F-score at 1 %, and give a third .04
LITTLE_WRONG, MUCH_WRONG = 0.025, 0.05


def asked(wrong: float) -> float:
    """The share of the hull's error that depth has to save, where masks prove the share `wrong` of
    all depth wrong.
    """
    return WORTH_AROUND * float(np.interp(wrong, [LITTLE_WRONG, MUCH_WRONG], [0, 1]))


def divided(
    fused: Mesh, hull: Mesh, share: Callable[[np.ndarray], np.ndarray], least: float
) -> tuple[np.ndarray, Mesh]:
    """Which vertices (n,) bool of the fused surface depth has earned, and the hull's points where
    it has not. share: of the hull's error that depth saves around points (n, 3).
    """
    lost = share(hull.vertices) < least
    rest = Mesh(hull.vertices[lost], np.zeros((0, 3), np.int64), hull.normals[lost])
    return share(fused.vertices) >= least, rest
