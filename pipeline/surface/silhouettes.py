"""What the masks say about where the object is: their hull, and how far they are to be believed."""

from __future__ import annotations

from collections.abc import Container
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from pipeline.base.errors import InputError
from pipeline.geometry.cameras import Rig, View
from pipeline.geometry.mesh_io import Mesh, vertex_normals
from pipeline.geometry.voxels import Grid
from pipeline.masks.agreement import hull_points
from pipeline.surface.clean import zero_surface
from pipeline.surface.field import hull_of, signed_distance
from pipeline.surface.pictures import at_size, reduced
from pipeline.surface.preview import Silhouette

TRUNCATION = 4.0  # cells
SLAB = 1.5  # cells above the ground, below which nothing is the object's
TOLERANCES = (0.0, 0.04, 0.08, 0.12)  # shares of masks that may be wrong, of which one is chosen
JUDGED_GRID = 128  # cells of the hulls that are compared for it
JUDGED_SIDE = 400  # pixels of the longer side of the masks that surfaces are compared with


@dataclass(frozen=True)
class Silhouettes:
    """What the masks say about where the object is.

    rig: all views; carving: those whose masks may remove volume; masks: name -> (h, w) bool;
    tolerance: share of masks that may be wrong, for a surface made of them alone; points (n, 3)
    fill their common volume to within `margin`; ground: height of the plane that the object stands
    on, None where no plane is known or the user's own masks say where the object ends; given: all
    masks are the user's own.
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
        above = (y - self.ground - SLAB * grid.cell) / (TRUNCATION * grid.cell)
        return np.minimum(field, above[None, :, None])

    def raised(self, grid: Grid, mesh: Mesh) -> Mesh:
        """The mesh with what lies lower than a field `above_ground` reaches lifted to its end."""
        if self.ground is None:
            return mesh
        vertices = mesh.vertices.copy()
        vertices[:, 1] = np.maximum(vertices[:, 1], self.ground + SLAB * grid.cell)
        return Mesh(vertices, mesh.faces, vertex_normals(vertices, mesh.faces))

    @cached_property
    def small(self) -> list[tuple[View, np.ndarray]]:
        """The carving views and their masks with at most JUDGED_SIDE pixels along a side."""
        masks = [self.masks[view.name] for view in self.carving]
        reduced_to = [reduced(mask, JUDGED_SIDE / max(mask.shape)) > 0.5 for mask in masks]
        return [(at_size(view, mask), mask) for view, mask in zip(self.carving, reduced_to)]

    def covered(self, mesh: Mesh) -> list[np.ndarray]:
        """The pixels of every small mask that a mesh covers, bool (h, w) each."""
        covered_in = Silhouette(mesh)
        return [mask & covered_in(view) for view, mask in self.small]


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
    seen = Silhouettes(rig, carving, masks, TOLERANCES[0], points, margin, ground, given)
    return replace(seen, tolerance=_believed(seen))


def _believed(seen: Silhouettes) -> float:
    """The first of TOLERANCES after which the contradiction grows: it falls as long as wrong masks
    are outvoted, and rises as the hull grows too large.
    """
    small = {view.name: mask for view, mask in seen.small}
    judged = replace(seen, masks=small)
    best = TOLERANCES[0]
    least = contradiction(judged, best)
    for tolerance in TOLERANCES[1:]:
        found = contradiction(judged, tolerance)
        if found > least:
            break
        if found < least:  # few views are as strict with a small share of them as with none
            best, least = tolerance, found
    return best


def contradiction(seen: Silhouettes, tolerance: float) -> float:
    """Of the hull with that tolerance: how much of the masks it leaves empty, and how much it fills
    beside them, as a share of the masks. Within a cell of an outline nothing counts, for there the
    grid decides.

    A strict hull leaves whatever one wrong mask denies; a tolerant one is too large everywhere.
    """
    grid = seen.grid(JUDGED_GRID)
    field = seen.above_ground(grid, seen.hull(grid, tolerance))
    hull = zero_surface(field, grid, seen.covered, blur=0)
    if hull is None:
        return np.inf
    covered_in = Silhouette(hull)
    wrong = total = 0.0
    for full in seen.carving:
        mask = seen.masks[full.name]
        view = at_size(full, mask)
        cell = grid.cell * view.fx / np.linalg.norm(full.position - seen.rig.center)
        away = np.abs(signed_distance(mask))
        wrong += float(((covered_in(view) != mask) & (away > cell)).sum())
        total += float(mask.sum())
    return wrong / max(total, 1.0)


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
