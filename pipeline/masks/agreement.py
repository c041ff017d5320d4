"""How well each mask agrees with the hull of all: a mask that is missing a part would carve the
object away.
"""

from __future__ import annotations

from collections.abc import Container

import cv2
import numpy as np

from pipeline.geometry.cameras import Rig
from pipeline.geometry.voxels import Grid, sample, silhouette

LEAST_AGREEMENT = 0.6  # IoU with the hull's silhouette below which a mask does not carve


def vote(
    rig: Rig, masks: dict, grid: Grid, names: Container[str] | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Per cell (n,): in how many views it lies inside the mask, and in how many it is in the
    frame. `names`: the views that count; None: all.
    """
    points = grid.centers()
    inside = np.zeros(len(points), np.int32)
    seen = np.zeros(len(points), np.int32)
    for v in rig.views:
        if names is not None and v.name not in names:
            continue
        value, framed = sample(v, masks[v.name].astype(np.uint8), points)
        inside += (value > 0) & framed
        seen += framed
    return inside, seen


def hull_points(
    rig: Rig,
    masks: dict,
    longest: int = 72,
    tolerance: float = 0.12,
    given: Container[str] = (),
) -> tuple[np.ndarray, float]:
    """Cell centres (n, 3) inside at least 1 - tolerance of the masks that see them and all masks of
    the views named in `given`, and the cell size.

    Two passes: over the scene's sphere, then over what the first pass found.
    """
    low = rig.center - rig.radius
    high = rig.center + rig.radius
    for _ in range(2):
        grid = Grid.over(low, high, longest)
        inside, seen = vote(rig, masks, grid)
        often_seen = seen >= max(2, 0.5 * len(rig.views))
        solid = (inside >= (1 - tolerance) * seen) & often_seen
        inside, seen = vote(rig, masks, grid, given)
        kept = grid.centers()[solid & (inside == seen)]
        if not len(kept):
            return kept, grid.cell

        low = kept.min(0) - 2 * grid.cell
        high = kept.max(0) + 2 * grid.cell
    return kept, grid.cell


def agreement(rig: Rig, masks: dict) -> dict[str, dict]:
    """name -> {"confidence": IoU of the mask with the hull's silhouette, "carve": whether it may
    remove volume}.
    """
    points, cell = hull_points(rig, masks)
    out = {}
    for v in rig.views:
        mask = masks[v.name]
        size = (max(1, v.width // 2), max(1, v.height // 2))
        small = cv2.resize(mask.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0
        hull = silhouette(v, points, cell, size) if len(points) else np.zeros_like(small)

        union = (small | hull).sum()
        iou = float((small & hull).sum() / union) if union else 0.0
        out[v.name] = {"confidence": iou, "carve": bool(iou >= LEAST_AGREEMENT)}
    return out
