"""What depth maps carve out of a fused surface although masks prove it solid.

Depth of what is plain, dark or mirrors is noise or lies behind the surface: depth maps look through
a shield of bright metal, and fusion takes it away. In one photo after the other its mask is empty
there. What enough masks ask for is solid, unless as many depth maps look through it: those see what
lies behind a gap that masks have closed. Nor is a part solid that ground is seen through: made
masks hold shreds of it. Where a depth map looks through what is solid it is wrong, and it would
carve what lies beside that as well, which no outline shows.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import ndimage

from pipeline.geometry.voxels import Grid, sample
from pipeline.surface.clean import zero_surface
from pipeline.surface.depth import Depth
from pipeline.surface.silhouettes import TRUNCATION, Silhouettes
from pipeline.surface.solids import contour
from pipeline.surface.zbuffer import Crop, z_buffer

LEAST_ASKING = 3  # masks that have to ask for a cell: one or two may be wrong
SHRED = 0.3  # of a part, before the ground in some photo: the part is a shred of ground


def carved_solids(
    fused: np.ndarray,
    hull: np.ndarray,
    free: np.ndarray,
    depths: list[Depth],
    grid: Grid,
    seen: Silhouettes,
) -> np.ndarray:
    """The cells, bool, of the `hull` that the `fused` field has lost and masks prove solid.

    fused, hull: positive inside; free: how many of the depth maps look through a cell; all of the
    grid's shape. A mask asks for the cells before those of its pixels that the hull's surface
    covers and the fused one does not.
    """
    lost = (hull > 0) & (fused < 0)
    if not lost.any():
        return lost
    points = grid.centers()[lost.ravel()]
    asking = np.zeros(len(points))
    outlines = (_outline(field, grid, seen) for field in (hull, fused))
    for (view, _), whole, left in zip(seen.small, *outlines):
        value, inside = sample(view, (whole & ~left).astype(np.uint8), points)
        asking += inside & (value > 0)
    out = np.zeros(grid.shape, bool)
    out[lost] = (asking >= LEAST_ASKING) & (asking > free[lost])
    if seen.ground is None:
        return out
    before = np.zeros(grid.shape, bool)
    asked_for = points[out[lost]]
    before[out] = _before_ground(asked_for, seen.ground, depths, TRUNCATION * grid.cell)
    return _without_shreds(out, before)


def _without_shreds(solid: np.ndarray, before: np.ndarray) -> np.ndarray:
    """The solid cells, bool, but for connected parts of which SHRED is seen before the ground."""
    labels, count = ndimage.label(solid)
    cells = np.bincount(labels.ravel(), minlength=count + 1)
    seen_before = np.bincount(labels[before], minlength=count + 1)
    kept = seen_before <= SHRED * cells
    kept[0] = False
    return kept[labels]


def _before_ground(
    points: np.ndarray, ground: float, depths: list[Depth], margin: float
) -> np.ndarray:
    """Whether a depth map shows the ground, to within `margin`, through points (n, 3)."""
    out = np.zeros(len(points), bool)
    for found in depths:
        h, w = found.depth.shape
        view = found.view.at_size(w, h)
        origin, direction = view.rays(view.pixel_centers())
        along = found.depth / (direction @ view.world_to_camera[2, :3])
        height = origin[..., 1] + along * direction[..., 1]
        flat = (found.agreeing > 0) & (np.abs(height - ground) < margin)
        shown, inside = sample(view, np.where(flat, found.depth, 0).astype(np.float32), points)
        out |= inside & (view.project(points)[1] < shown - margin)
    return out


def _outline(field: np.ndarray, grid: Grid, seen: Silhouettes) -> list[np.ndarray]:
    """The pixels of every small mask that the field's surface covers, bool (h, w) each."""
    surface = zero_surface(field, grid, seen.covered)
    if surface is None:
        return [np.zeros_like(mask) for _, mask in seen.small]
    return seen.covered(surface)


def without_seen_through(
    depths: list[Depth], solid: np.ndarray, grid: Grid
) -> tuple[list[Depth], float]:
    """The depth maps without depth behind `solid` cells (bool, of the grid's shape), by more than
    fusion would forgive, and what share of all depth that is.
    """
    if not solid.any():
        return depths, 0.0
    surface = contour(np.where(solid, 1.0, -1.0), grid)
    out, wrong, total = [], 0, 0
    for found in depths:
        h, w = found.depth.shape
        crop = Crop.around(found.view.at_size(w, h), surface.vertices, margin=0)
        nearest = np.zeros((h, w), np.float32)
        crop.of(nearest)[...] = z_buffer(crop, surface.vertices, surface.faces)[0]
        behind = (nearest > 0) & (found.depth > nearest + TRUNCATION * grid.cell)
        wrong += int((behind & (found.agreeing > 0)).sum())
        total += int((found.agreeing > 0).sum())
        out.append(replace(found, agreeing=np.where(behind, 0, found.agreeing)))
    return out, wrong / max(total, 1)
