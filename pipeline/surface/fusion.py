"""Masks and depth maps become one field over a grid, whose zero surface is the object.

hull: soft visual hull. fused: where depth maps stand, they make the surface; the hull does
elsewhere. Both end in marching cubes, always closed. The fused one, which holds more, has to earn
its place: it is taken where it predicts photos that were left out better, and fills the masks that
were given (prediction.py).
"""

from __future__ import annotations

from collections.abc import Container
from dataclasses import asdict, dataclass

import numpy as np

from pipeline.base.config import Mesh as MeshSettings
from pipeline.base.errors import InputError
from pipeline.geometry.cameras import Rig, View
from pipeline.geometry.mesh_io import Mesh
from pipeline.geometry.voxels import Grid
from pipeline.masks.agreement import hull_points
from pipeline.surface.clean import to_mesh, zero_surface
from pipeline.surface.depth import Depth, depth_maps
from pipeline.surface.field import hull_of, projections, stacked, stereo_field
from pipeline.surface.prediction import Gain, gain

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
    the user's own masks say where the object ends; given: all masks are the user's own.
    """

    rig: Rig
    carving: list[View]
    masks: dict[str, np.ndarray]
    tolerance: float
    points: np.ndarray
    margin: float
    ground: float | None
    given: bool

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

    def above_ground(self, grid: Grid, field: np.ndarray) -> np.ndarray:
        """The field without what lies below the ground, where one is known: nothing of the object
        does, and a thin slab of ground would stick to it.
        """
        if self.ground is None:
            return field
        y = grid.low[1] + (np.arange(grid.shape[1]) + 0.5) * grid.cell
        above = (y - self.ground - 1.5 * grid.cell) / (TRUNCATION * grid.cell)
        return np.minimum(field, above[None, :, None])


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
    tolerance = 0.04 if given else 0.08
    return Silhouettes(rig, carving, masks, tolerance, points, margin, ground, given)


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


def build_surface(
    seen: Silhouettes, images: list[np.ndarray], settings: MeshSettings, threads: int
) -> tuple[Mesh, Grid, dict]:
    """Surface and grid by the chosen method, and the facts behind the choice.

    images: the photos as grey (h, w) in [0, 1], sRGB-encoded, one per view of the rig.
    """
    depths: list[Depth] = []
    facts: dict = {"depth_share": None}
    if settings.method != "hull":
        around = seen.grid(RANGE_GRID)
        rough = to_mesh(seen.hull(around, LOOSE), around)
        depths, facts["depth_share"] = depth_maps(
            seen.rig.views,
            images,
            rough,
            seen.margin,
            settings.depth_pixels,
            threads,
            seen.ground,
        )
    method, why = _trusted(settings, facts["depth_share"])

    grid = seen.grid(settings.grid)
    strict = seen.above_ground(grid, seen.hull(grid, seen.tolerance))
    if method == "hull":
        return to_mesh(strict, grid), grid, {"method": method, "why": why} | facts

    fused = fuse(grid, strict, seen.hull(grid, LOOSE), depths)
    surface = to_mesh(seen.above_ground(grid, fused), grid)
    hull = zero_surface(strict, grid)
    if settings.method == "auto" and hull is not None:
        masks = [seen.masks[view.name] for view in seen.rig.views]
        found = gain(hull, surface, seen.rig.views, images, masks)
        facts["gain_over_hull"] = asdict(found)
        taken, words = _judged(found, seen.given)
        why = f"{why}; {words}"
        if not taken:
            method, surface = "hull", hull
    return surface, grid, {"method": method, "why": why} | facts


def _trusted(settings: MeshSettings, share: float | None) -> tuple[str, str]:
    """`hull` or `fused`, and why. `share`: of the hull's pixels with depth."""
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


def _judged(found: Gain, given: bool) -> tuple[bool, str]:
    """Whether the fused surface is taken, by its `gain` over the hull, and why in plain words.

    given: the masks are the user's own, so that it has to fill them. Masks that were made may hold
    ground, which depth tells from the object.
    """
    share = f"{100 * abs(found.share):.1f} % ± {100 * found.standard_error:.1f}"
    if not found.clear:
        less = "better" if found.share > 0 else "worse"
        return False, (
            "but the fused surface does not clearly predict photos left out better than the hull "
            f"({share} {less}), so the hull is taken"
        )
    words = f"the fused surface predicts photos left out better than the hull, by {share}"
    if given and not found.fills:
        empty = f"{100 * found.empty:.0f} % of what the hull fills of the given masks"
        return False, f"{words}, but leaves {empty} empty, so the hull is taken"
    return True, words
