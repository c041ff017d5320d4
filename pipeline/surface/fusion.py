"""Masks and depth maps become one field over a grid, whose zero surface is the object.

hull: soft visual hull, drawn taut over the masks' outlines (taut.py). fused: where depth maps
stand, they make the surface; the hull does elsewhere, and where masks prove depth wrong
(filling.py). Both end in marching cubes, always closed. The fused one is made anew from what is
known of it (screened_poisson.py), the hull's where depth has not earned its place (earned.py); then
it moves to where photos agree (photometric.py), and has to
earn its place: it is taken where it predicts photos that were left out better than the hull, and
fills the masks (prediction.py). Only then is it drawn to the edges of given masks too
(outlines.py): that helps noise as much as a surface. Masks that were made may hold ground, which
depth tells from the object.
"""

from __future__ import annotations

from dataclasses import asdict, replace
from typing import NamedTuple

import numpy as np

from pipeline.base.config import Mesh as MeshSettings
from pipeline.geometry.mesh_io import Mesh
from pipeline.geometry.voxels import Grid
from pipeline.surface.clean import to_mesh, zero_surface
from pipeline.surface.depth import Depth, depth_maps, neighbours
from pipeline.surface.earned import asked, divided
from pipeline.surface.field import projections, stacked, stereo_field
from pipeline.surface.filling import carved_solids, without_seen_through
from pipeline.surface.normal_filter import LEAST, filtered_normals, steps_of
from pipeline.surface.photometric import Refined, Refinement, refine_mesh
from pipeline.surface.prediction import Gain, gain, gain_around
from pipeline.surface.screened_poisson import rebuilt
from pipeline.surface.silhouettes import TRUNCATION, Silhouettes
from pipeline.surface.taut import taut

# Shares of masks that may be wrong where depth maps stand, and between them, of masks that were
# given and made. A hull by itself is as strict as masks agree; but beside depth maps a strict one
# shaves outlines by part of a cell: on a toy of bricks 6 % more error in photos left out.
LOOSE = 0.25
BESIDE_DEPTH = {True: 0.04, False: 0.08}
LEAST_WEIGHT = 3.0  # agreeing views, summed over depth maps, that make a surface
LEAST_FREE = 0.02  # depth maps that look through a cell empty it if they are more than this of them
NEIGHBOURS = 4  # photos that refinement compares each photo with
# share of depth that masks may prove wrong: what is left of more is no better where outlines cannot
# tell. .67 on a bronze duck that mirrors all over, whose hull is nearer to the truth, .46 on
# suzanne, whose fused surface predicts photos better, .22 and less on eight other things
MOST_WRONG = 0.5
RANGE_GRID = 96  # cells of the hull that bounds the search of depth


class Fused(NamedTuple):
    """Arrays of a grid's shape: the field, positive inside; agreeing views, summed over depth maps;
    and how many of these look through a cell.
    """

    field: np.ndarray
    weight: np.ndarray
    free: np.ndarray


def fuse(grid: Grid, strict: np.ndarray, loose: np.ndarray, depths: list[Depth]) -> Fused:
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
    seen_through = (free >= 1) & (free > LEAST_FREE * weight)
    return Fused(np.where(seen_through, np.minimum(out, -0.5), out), weight, free)


def fuse_what_masks_allow(
    grid: Grid,
    seen: Silhouettes,
    depths: list[Depth],
    hull: Mesh | None,
    images: list[np.ndarray],
    threads: int,
) -> tuple[Mesh, dict]:
    """The surface of the depth maps above the ground, which are fused twice: what they carve
    although masks prove it solid shows which depth is wrong, and without that they are fused again.
    What is carved still is the hull's. It is made anew from what is known of it (`rebuilt`), and
    once more, where masks prove some of the depth wrong, with the `hull` drawn taut in place of
    what has not earned its place (earned.py). And facts: the shares of depth, of the hull's volume
    and of points. Raises InputError where nothing is left.
    """
    strict = seen.above_ground(grid, seen.hull(grid, BESIDE_DEPTH[seen.given]))
    loose = seen.above_ground(grid, seen.hull(grid, LOOSE))

    def carved(believed: list[Depth]) -> tuple[Fused, np.ndarray]:
        fused = fuse(grid, strict, loose, believed)
        fused = fused._replace(field=seen.above_ground(grid, fused.field))
        return fused, carved_solids(fused.field, strict, fused.free, believed, grid, seen)

    _, solid = carved(depths)
    believed, wrong = without_seen_through(depths, solid, grid)
    fused, solid = carved(believed)
    torn = to_mesh(np.where(solid, strict, fused.field), grid, seen.covered)
    known_of = (fused.weight, strict, grid, len(depths), seen.covered)
    surface, anew = rebuilt(torn, *known_of)
    filled = float(solid.sum() / max((strict > 0).sum(), 1))
    facts: dict = {"depth_proven_wrong": wrong, "filled": filled, "asked_around": asked(wrong)}
    if facts["asked_around"] > 0 and hull is not None:
        drawn = _taut(hull, seen, threads)
        masks = [seen.masks[view.name] for view in seen.rig.views]
        share = gain_around(drawn, surface, seen.rig.views, images, masks, grid)
        earned, rest = divided(torn, drawn, share, facts["asked_around"])
        surface, anew = rebuilt(torn, *known_of, earned, rest)
        facts["earned"] = float(earned.mean())
    return seen.raised(grid, surface), facts | {"made_anew": anew}


def build_surface(
    seen: Silhouettes, images: list[np.ndarray], settings: MeshSettings, threads: int
) -> tuple[Mesh, Grid, dict]:
    """Surface and grid by the chosen method, and the facts behind the choice. The surface's normals
    are without noise (normal_filter.py).

    images: the photos as grey (h, w) in [0, 1], sRGB-encoded, one per view of the rig.
    """
    depths, share = (
        ([], None) if settings.method == "hull" else _depths(seen, images, settings, threads)
    )
    method, why = _trusted(settings, share)
    facts: dict = {"depth_share": share, "masks_that_may_be_wrong": seen.tolerance}

    grid = seen.grid(settings.grid)
    field = seen.above_ground(grid, seen.hull(grid, seen.tolerance))
    if method == "hull":
        alone = _taut(to_mesh(field, grid, seen.covered), seen, threads)
        return alone, grid, {"method": method, "why": why} | facts

    hull = zero_surface(field, grid, seen.covered)
    surface, filling = fuse_what_masks_allow(grid, seen, depths, hull, images, threads)
    facts["filling"] = filling
    if "earned" in filling:
        why = f"{why}; {_not_earned(filling)}"
    steps = (settings.refine_steps,) * len(Refinement.scales)
    moved = _moved(surface, seen, images, Refinement(steps, plate=settings.plate), None, threads)
    facts["refinement"] = moved.facts
    if settings.method == "auto" and hull is not None:
        masks = [seen.masks[view.name] for view in seen.rig.views]
        found = gain(hull, moved.mesh, seen.rig.views, images, masks)
        facts["gain_over_hull"] = asdict(found)
        taken, words = _judged(found, seen.given, filling["depth_proven_wrong"])
        why = f"{why}; {words}"
        if not taken:
            return _taut(hull, seen, threads), grid, {"method": "hull", "why": why} | facts
    if seen.given:
        fine = Refinement(steps[-1:], Refinement.scales[-1:], settings.plate)
        moved = _moved(moved.mesh, seen, images, fine, _believed(seen), threads)
        facts["outlines"] = moved.facts
    return (
        _without_noise(moved.mesh, steps_of(moved.known)),
        grid,
        {"method": method, "why": why} | facts,
    )


def _depths(
    seen: Silhouettes, images: list[np.ndarray], settings: MeshSettings, threads: int
) -> tuple[list[Depth], float]:
    """Depth maps of all photos, and for what share of the object's pixels they have depth."""
    around = seen.grid(RANGE_GRID)
    rough = to_mesh(seen.hull(around, LOOSE), around, seen.covered)
    views, pixels = seen.rig.views, settings.depth_pixels
    return depth_maps(views, images, rough, seen.margin, pixels, threads, seen.ground)


def _taut(hull: Mesh, seen: Silhouettes, threads: int) -> Mesh:
    """The hull drawn taut over the outlines of the masks that it was carved by."""
    drawn = taut(hull, seen.carving, [seen.masks[view.name] for view in seen.carving], threads)
    return _without_noise(drawn, np.full(len(drawn.vertices), LEAST))


def _without_noise(mesh: Mesh, steps: np.ndarray) -> Mesh:
    """The mesh with its normals filtered by so many steps (n,)."""
    return replace(mesh, normals=filtered_normals(mesh, steps))


def _believed(seen: Silhouettes) -> list[np.ndarray | None]:
    """The user's masks whose edges pull at a fused surface, None for those that disagree."""
    names = {view.name for view in seen.carving}
    return [seen.masks[v.name] if v.name in names else None for v in seen.rig.views]


def _moved(
    surface: Mesh,
    seen: Silhouettes,
    images: list[np.ndarray],
    settings: Refinement,
    masks: list[np.ndarray | None] | None,
    threads: int,
) -> Refined:
    """The surface moved to where photos agree best and, where there are masks, to their edges; as
    it is, and taken for well known, where no steps are wanted.
    """
    if not any(settings.steps):
        return Refined(surface, np.ones(len(surface.vertices)), {})
    near = neighbours(seen.rig.views, seen.rig.center, NEIGHBOURS)
    return refine_mesh(surface, seen.rig.views, images, near, settings, masks, threads)


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


def _not_earned(filling: dict) -> str:
    """Of `fuse_what_masks_allow`'s facts, where the hull stands in, in plain words."""
    percent = lambda share: f"{100 * share:.0f} %"
    return (
        f"masks prove {percent(filling['depth_proven_wrong'])} of the depth wrong, so the hull "
        f"stands in for {percent(1 - filling['earned'])} of its surface, around which it saves "
        f"less than {percent(filling['asked_around'])} of the hull's error"
    )


def _judged(found: Gain, given: bool, wrong: float) -> tuple[bool, str]:
    """Whether the fused surface is taken, by its `gain` over the hull, and why in plain words.

    given: the masks are the user's own; wrong: the share of depth that masks prove wrong.
    """
    share = f"{100 * abs(found.share):.1f} % ± {100 * found.standard_error:.1f}"
    if not found.clear(given):
        less = "better" if found.share > 0 else "worse"
        return False, (
            "but the fused surface does not clearly predict photos left out better than the hull "
            f"({share} {less}), so the hull is taken"
        )
    words = f"the fused surface predicts photos left out better than the hull, by {share}"
    if not found.fills:
        empty = f"{100 * found.empty:.0f} % of what the hull fills of the masks"
        return False, f"{words}, but leaves {empty} empty, so the hull is taken"
    if wrong > MOST_WRONG:
        known = f"masks prove {100 * wrong:.0f} % of all depth wrong"
        return False, f"{words}, but {known}, so the hull is taken"
    return True, words
