"""The object's sphere, once masks are known.

The poses stage finds it by matched points, and smooth or thin parts have few: a sphere that is too
small cuts the masks. So where the masks' volume reaches the sphere it is widened, and masks are
made again.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from pipeline.geometry.cameras import Rig
from pipeline.masks.agreement import hull_points
from pipeline.photos.object_sphere import MARGIN

# of the radius: how far a volume reaches that the sphere cuts. Of seven things that it did not cut
# .81 to .88, of two that it cut 1.12 and 1.13
CUT = 0.97
WIDER = 1.75  # of the sphere about a volume that was cut
TURNS = 2  # at most; what does not end within them is not an object

Made = tuple[dict[str, np.ndarray], dict]  # masks by the view's name, and facts


def in_a_sphere_that_holds(rig: Rig, make: Callable[[Rig], Made]) -> tuple[Rig, Made]:
    """The scene with a sphere that holds the volume of the masks that `make` finds in it, and these
    masks and facts; in the facts `sphere_widened`, by how much, and where it was
    `larger_than_points`: the volume's radius over that of the matched points.

    Where a volume reaches every sphere it is the first one's, and `sphere_widened` is None.
    """
    scene = rig
    made = first = make(rig)
    for turn in range(TURNS + 1):
        masks, facts = made
        volume = hull_points(scene, masks)[0]
        if not cut(scene, volume):
            facts = facts | {"sphere_widened": scene.radius / rig.radius}
            if turn:
                reach = farthest(volume, middle(volume))
                facts["larger_than_points"] = MARGIN * reach / rig.radius
            return scene, (masks, facts)
        if turn < TURNS:
            scene = widened(scene, volume)
            made = make(scene)
    return rig, (first[0], first[1] | {"sphere_widened": None})


def cut(rig: Rig, volume: np.ndarray) -> bool:
    """Whether the object's sphere cuts a volume's cells (n, 3)."""
    return len(volume) > 0 and farthest(volume, rig.center) > CUT * rig.radius


def widened(rig: Rig, volume: np.ndarray) -> Rig:
    """The scene with a wider sphere about the middle of a volume's box; cells (n, 3)."""
    center = middle(volume)
    return rig.about(center, WIDER * farthest(volume, center))


def middle(volume: np.ndarray) -> np.ndarray:
    """Of the box of a volume's cells (n, 3)."""
    return 0.5 * (volume.min(0) + volume.max(0))


def farthest(volume: np.ndarray, center: np.ndarray) -> float:
    """Distance of the farthest cell (n, 3) from a centre (3,)."""
    return float(np.linalg.norm(volume - center, axis=1).max())
