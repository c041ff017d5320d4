"""Masks and depth maps become one field over a grid, whose zero surface is the object.

SURFACE_METHODS: name -> function(grid, strict hull, loose hull, depth maps) -> field. hull: soft
visual hull. fused: where depth maps stand, they make the surface; the hull does elsewhere. Both end
in marching cubes, always closed.
"""

from __future__ import annotations

from collections.abc import Callable, Container
from dataclasses import dataclass

import numpy as np

from pipeline.base.config import Mesh as MeshSettings
from pipeline.base.errors import InputError
from pipeline.geometry.cameras import Rig, View
from pipeline.geometry.voxels import Grid
from pipeline.masks.agreement import hull_points
from pipeline.surface.clean import to_mesh
from pipeline.surface.depth import Depth, depth_maps
from pipeline.surface.field import hull_of, projections, stacked, stereo_field

TRUNCATION = 4.0  # cells
LOOSE = 0.25  # share of masks that may be wrong where depth maps stand
LEAST_WEIGHT = 3.0  # agreeing views, summed over depth maps, that make a surface
LEAST_FREE = 0.02  # depth maps that look through a cell empty it if they are more than this of them
RANGE_GRID = 96  # cells of the hull that bounds the search of depth


@dataclass(frozen=True)
class Silhouettes:
    """What the masks say about where the object is.

    rig: all views; carving: those whose masks may remove volume; masks: name -> (h, w) bool;
    tolerance: share of masks that may be wrong; points (n, 3) fill their common volume to within
    `margin`; ground: height of the plane that the object stands on, None where no plane is known or
    the user's own masks say where the object ends.
    """

    rig: Rig
    carving: list[View]
    masks: dict[str, np.ndarray]
    tolerance: float
    points: np.ndarray
    margin: float
    ground: float | None

    def grid(self, longest: int) -> Grid:
        """A grid around the object with `longest` cells along its longest side."""
        low = self.points.min(0) - self.margin
        high = self.points.max(0) + self.margin
        if self.ground is not None:
            low[1] = max(low[1], self.ground - 0.02 * (high[1] - low[1]))
        return Grid.over(low, high, longest)

    def hull(self, grid: Grid, tolerance: float) -> np.ndarray:
        """Soft visual hull field."""
        masks = [self.masks[v.name] for v in self.carving]
        return hull_of(grid, self.carving, masks, TRUNCATION * grid.cell, tolerance)


def silhouettes_of(rig: Rig, masks: dict, carve: Container[str], given: bool) -> Silhouettes:
    """What the masks say; carve: names of the views that may take volume away; given: all masks
    are the user's own. Raises InputError where they have no volume in common or too few agree.
    """
    points, margin = coarse_hull(rig, masks)
    carving = [v for v in rig.views if v.name in carve]
    if len(carving) < 3:
        raise InputError(
            "fewer than 3 masks agree with each other",
            "masks",
            "correct the masks in the scene's folder masks/",
        )
    plane = None if given else rig.facts.get("plane")
    ground = None if plane is None else float(plane["offset"])
    return Silhouettes(rig, carving, masks, 0.04 if given else 0.08, points, margin, ground)


def coarse_hull(rig: Rig, masks: dict) -> tuple[np.ndarray, float]:
    """Points (n, 3) that fill the masks' common volume, and a margin within which it is known.

    InputError naming the worst views when there is no common volume.
    """
    points, cell = hull_points(rig, masks, 72, 0.15)
    if len(points):
        return points, 2.5 * cell

    area = {n: float(m.mean()) for n, m in masks.items()}
    worst = sorted(area, key=area.__getitem__)[:3]
    raise InputError(
        f"the masks have no volume in common; smallest masks: {', '.join(worst)}",
        "masks",
        "look at masks/overlay.jpg and correct those masks in the scene's folder masks/",
    )


def only_hull(grid: Grid, strict: np.ndarray, loose: np.ndarray, depths: list[Depth]) -> np.ndarray:
    """The visual hull as it is."""
    return strict


def fuse(grid: Grid, strict: np.ndarray, loose: np.ndarray, depths: list[Depth]) -> np.ndarray:
    """The mean of the depth maps' truncated distances (Curless and Levoy 1996), inside the loose
    hull, wherever the agreeing views sum to LEAST_WEIGHT; the strict hull elsewhere. A cell that a
    depth map looks through is empty.
    """
    h, w = depths[0].depth.shape
    behind, weight, free = stereo_field(
        grid.low.astype(np.float32),
        np.float32(grid.cell),
        grid.shape,
        projections([d.view for d in depths], w, h),
        stacked([d.depth for d in depths]),
        stacked([d.agreeing for d in depths]),
        np.float32(TRUNCATION * grid.cell),
    )
    out = np.where(weight >= LEAST_WEIGHT, np.minimum(loose, behind), strict)
    return np.where((free >= 1) & (free > LEAST_FREE * weight), np.minimum(out, -0.5), out)


SURFACE_METHODS: dict[str, Callable[..., np.ndarray]] = {"hull": only_hull, "fused": fuse}


def build_field(
    seen: Silhouettes, images: list[np.ndarray], settings: MeshSettings, threads: int
) -> tuple[np.ndarray, Grid, dict]:
    """Field and grid by the chosen method, and the facts behind the choice.

    images: the photos as grey (h, w) in [0, 1], sRGB-encoded, one per view of the rig.
    """
    depths: list[Depth] = []
    share = None
    if settings.method != "hull":
        around = seen.grid(RANGE_GRID)
        hull = to_mesh(seen.hull(around, LOOSE), around)
        depths, share = depth_maps(
            seen.rig.views,
            images,
            hull,
            seen.margin,
            settings.depth_pixels,
            threads,
            seen.ground,
        )
    method, why = _choose(settings, share)

    grid = seen.grid(settings.grid)
    loose = seen.hull(grid, LOOSE)
    field = SURFACE_METHODS[method](grid, seen.hull(grid, seen.tolerance), loose, depths)

    # nothing of the object lies below the ground; a thin slab of ground would stick to it
    if seen.ground is not None:
        y = grid.low[1] + (np.arange(grid.shape[1]) + 0.5) * grid.cell
        above = (y - seen.ground - 1.5 * grid.cell) / (TRUNCATION * grid.cell)
        field = np.minimum(field, above[None, :, None])
    return field, grid, {"method": method, "why": why, "depth_share": share}


def _choose(settings: MeshSettings, share: float | None) -> tuple[str, str]:
    """A key of SURFACE_METHODS, and why it was chosen. `share`: of the hull's pixels with depth."""
    if settings.method != "auto":
        return settings.method, "asked for"

    assert share is not None  # only the hull does without depth maps
    trusted = share >= settings.min_agreement
    why = (
        f"{100 * share:.0f} % of the object's pixels have depth that photos agree on; "
        f"{'at least' if trusted else 'less than'} {100 * settings.min_agreement:.0f} % "
        "are needed to trust it"
    )
    return ("fused" if trusted else "hull"), why
