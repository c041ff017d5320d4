"""Masks without a network: what differs from the bare ground plane, cut along edges, held together
by all views.

1. Warp every photo onto the ground plane; the median over views is the ground without the object,
   shadows included, because they do not move.
2. What differs from it, above 1.6 times the 95th percentile of the differences outside the object's
   sphere, is object; rays that miss the known ground say nothing.
3. A soft visual hull turns these log-odds into one volume.
4. GrabCut (Rother et al. 2004) between hull and background, twice, the second time with the hull of
   the first masks.

Frame: Y-up, ground at y = height. Arrays: lab, a photo in CIELAB (h, w, 3); ground (t, t, 3) and
spread (t, t), the ground's colour and how much it changes from view to view, t = TEXTURE; odds,
log-odds (h, w) in [-3, 3] that a pixel shows the object.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import cv2
import numpy as np
from scipy import ndimage

from pipeline.base.config import Masks
from pipeline.base.errors import InputError
from pipeline.base.images import linear_to_srgb, read_exr
from pipeline.base.progress import progress
from pipeline.geometry.cameras import Rig, View
from pipeline.geometry.voxels import Grid, sample, silhouette
from pipeline.masks.agreement import hull_points

WORKING = 600  # long side in pixels
TEXTURE = 512  # texels along the ground's side
EXTENT = 3.5  # half-side of the known ground in object radii
UNKNOWN = 99  # spread of ground that too few views have seen
CURE = "put masks into the scene's folder masks/"


def to_lab(path: Path, size: tuple[int, int]) -> np.ndarray:
    """Photo as CIELAB float32 (h, w, 3)."""
    image = cv2.resize(read_exr(path), size, interpolation=cv2.INTER_AREA)
    return cv2.cvtColor(linear_to_srgb(image), cv2.COLOR_RGB2Lab)


def ground_points(rig: Rig, height: float) -> np.ndarray:
    """(TEXTURE, TEXTURE, 3) points of the plane y = height around the object."""
    axis = np.linspace(-1, 1, TEXTURE) * EXTENT * rig.radius
    x, z = np.meshgrid(axis + rig.center[0], axis + rig.center[2], indexing="xy")
    return np.stack([x, np.full_like(x, height), z], -1)


def bare_ground(
    rig: Rig, labs: dict[str, np.ndarray], height: float
) -> tuple[np.ndarray, np.ndarray]:
    """Median colour (t, t, 3) over views and its spread (t, t); NaN where fewer than four views
    look.
    """
    points = ground_points(rig, height).reshape(-1, 3)
    stack = np.full((len(rig.views), len(points), 3), np.nan, np.float32)
    for k, v in enumerate(rig.views):
        value, inside = sample(v, labs[v.name], points, interpolate=True)
        stack[k, inside] = value[inside]
    median, spread, seen = _median_and_spread(stack)

    # seen from above, little ground hides behind the object: these views count alone where they can
    flatness = [-v.position[1] / np.linalg.norm(v.position - rig.center) for v in rig.views]
    steep = stack[np.argsort(flatness)[: max(6, round(0.35 * len(rig.views)))]]
    enough = np.isfinite(steep[..., 0]).sum(0) >= 4
    median[enough], spread[enough], _ = _median_and_spread(steep[:, enough])

    median[seen < 4] = np.nan
    spread[seen < 4] = np.nan
    return median.reshape(TEXTURE, TEXTURE, 3), spread.reshape(TEXTURE, TEXTURE)


def _median_and_spread(stack: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Over views (v, n, 3), NaN where one does not look: median (n, 3), median of the largest
    channel's distance from it (n,), and how many views look (n,).
    """
    seen = np.isfinite(stack[..., 0]).sum(0)
    median = _median(stack, seen)
    distance = np.abs(stack - median).max(-1, keepdims=True)
    return median, _median(distance, seen)[:, 0], seen


def _median(stack: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Median over axis 0 of (v, n, c) with NaN for unseen, `seen` (n,) values each; far faster than
    np.nanmedian.
    """
    ordered = np.sort(stack, axis=0)  # NaN sorts last
    middle = np.maximum(seen - 1, 0)[None, :, None] // 2
    return np.take_along_axis(ordered, middle, 0)[0]


def pixel_rays(view: View, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Origins and unit directions (h, w, 3) through the pixels of a view scaled to (w, h)."""
    w, h = size
    columns = (np.arange(w) + 0.5) * view.width / w
    rows = (np.arange(h) + 0.5) * view.height / h
    u, v = np.meshgrid(columns, rows)
    return view.rays(np.stack([u, v], -1))


def texture_coordinates(points: np.ndarray, rig: Rig) -> np.ndarray:
    """Column and row (..., 2), not rounded, of points (..., 3) in the ground's texture."""
    at = (points[..., [0, 2]] - rig.center[[0, 2]]) / (EXTENT * rig.radius)
    return (at + 1) / 2 * (TEXTURE - 1)


def pixel_ground(view: View, rig: Rig, height: float, size: tuple[int, int]) -> np.ndarray:
    """Texture coordinates (h, w, 2) of where each pixel's ray meets the ground; NaN where it does
    not.
    """
    o, d = pixel_rays(view, size)
    downward = d[..., 1] < -1e-4
    distance = np.where(downward, (height - o[..., 1]) / np.minimum(d[..., 1], -1e-4), np.nan)
    at = texture_coordinates(o + distance[..., None] * d, rig)
    within = ((at >= 0) & (at <= TEXTURE - 1)).all(-1, keepdims=True)
    return np.where(within, at, np.nan).astype(np.float32)


def sphere_region(view: View, rig: Rig, size: tuple[int, int]) -> np.ndarray:
    """Pixels (h, w) whose ray passes within 1.1 radii of the object's centre."""
    o, d = pixel_rays(view, size)
    to_center = rig.center - o
    along = (to_center * d).sum(-1)
    across = np.sqrt(np.maximum((to_center**2).sum(-1) - along**2, 0))
    return across < 1.1 * rig.radius


def footprint(rig: Rig, points: np.ndarray, cell: float, spread: np.ndarray) -> np.ndarray:
    """Texels (t, t) of the ground below the object: no photo shows them bare, their median is the
    object's own colour.

    Told from bare ground between parts of the object by colours that change from view to view.
    """
    at = texture_coordinates(points, rig).round().astype(int)
    column, row = np.clip(at, 0, TEXTURE - 1).T
    out = np.zeros((TEXTURE, TEXTURE), bool)
    out[row, column] = True

    texel = 2 * EXTENT * rig.radius / TEXTURE
    out = grow(ndimage.binary_closing(out, iterations=int(np.ceil(cell / texel)) + 1), 2)

    bare = np.nanmedian(spread[~out]) if np.isfinite(spread[~out]).any() else 3.0
    smooth = cv2.medianBlur(np.nan_to_num(spread, nan=UNKNOWN).astype(np.float32), 5)
    return out & (smooth > max(2.0 * bare, 5.0))


def _difference(lab: np.ndarray, ground: np.ndarray) -> np.ndarray:
    """Colour difference (h, w) of a photo to the ground as this view would see it (h, w, 3);
    lightness counts less than hue, and a pixel of misregistration is tolerated.
    """
    out = np.full(lab.shape[:2], np.inf, np.float32)
    for dy in (-1, 0, 1):
        for dx in (-1, 0, 1):
            shifted = np.roll(ground, (dy, dx), (0, 1))
            weighted = (lab - shifted) * [0.7, 1.3, 1.3]
            out = np.minimum(out, np.sqrt((weighted**2).sum(-1)))
    return out


def object_odds(
    view: View,
    rig: Rig,
    lab: np.ndarray,
    ground: np.ndarray,
    spread: np.ndarray,
    height: float,
    below: np.ndarray | None = None,
) -> np.ndarray:
    """Log-odds (h, w) in [-3, 3] that a pixel shows the object, from its difference to the bare
    ground.

    `below`: the footprint (t, t); a ray that ends there has most likely met the object.
    """
    size = lab.shape[1::-1]
    at = pixel_ground(view, rig, height, size)
    known = np.isfinite(at[..., 0])
    x = np.where(known, at[..., 0], -1)
    y = np.where(known, at[..., 1], -1)
    seen = lambda texture: cv2.remap(texture, x, y, cv2.INTER_LINEAR)

    hole = np.isnan(ground[..., 0])
    unsure = seen(np.where(hole, UNKNOWN, spread))
    known &= ~(seen(hole.astype(np.float32)) > 0)
    difference = _difference(lab, seen(np.where(hole[..., None], 0, ground)))

    inside = sphere_region(view, rig, size)
    outside = known & ~inside & (unsure < 20)
    threshold = 1.6 * np.percentile(difference[outside], 95) if outside.sum() > 500 else 25.0
    threshold = float(np.clip(threshold, 8, 40))
    odds = np.clip(3 * (difference - threshold) / threshold, -3, 3)
    odds = odds / (1 + np.maximum(unsure - 6, 0) / 6)  # a ground that changes says little

    if below is not None:
        under = seen(below.astype(np.float32)) > 0.5
        odds = np.where(under, np.maximum(odds, 0.6), odds)
    odds = np.where(known, cv2.blur(odds.astype(np.float32), (3, 3)), 0)
    return np.where(inside, odds, -3).astype(np.float32)


def soft_hull(
    rig: Rig, odds: dict[str, np.ndarray], height: float, longest: int = 80
) -> tuple[np.ndarray, float]:
    """Centres (n, 3) of the cells whose mean log-odds over views is positive and that few views
    speak against, in connected sets not much smaller than the largest; and the cell size.

    Two passes: over the scene's sphere, then over what the first pass found.
    """
    low = rig.center - rig.radius
    high = rig.center + rig.radius
    for _ in range(2):
        low[1] = max(low[1], height)
        grid = Grid.over(low, high, longest)
        points = grid.centers()
        solid = _solid(rig, odds, points)

        labels, count = ndimage.label(solid.reshape(grid.shape), np.ones((3, 3, 3)))
        if not count:
            return np.zeros((0, 3)), grid.cell
        sizes = np.bincount(labels.ravel())
        sizes[0] = 0
        points = points[sizes[labels.ravel()] >= 0.15 * sizes.max()]

        low = points.min(0) - 2 * grid.cell
        high = points.max(0) + 2 * grid.cell
    return points, grid.cell


def _solid(rig: Rig, odds: dict[str, np.ndarray], points: np.ndarray) -> np.ndarray:
    """Which points (n, 3) the views together hold for object (n,)."""
    total = np.zeros(len(points))
    against = np.zeros(len(points))
    seen = np.zeros(len(points))
    for v in rig.views:
        value, inside = sample(v, odds[v.name], points)
        total += np.where(inside, value, 0)
        against += inside & (value < -1.5)
        seen += inside
    return (total > 0.4 * seen) & (against < 0.15 * seen) & (seen >= 0.5 * len(rig.views))


def grow(mask: np.ndarray, pixels: int) -> np.ndarray:
    """Dilate a mask (h, w) bool by `pixels`, or erode it by as many where they are negative."""
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * abs(pixels) + 1,) * 2)
    return (cv2.dilate if pixels > 0 else cv2.erode)(mask.astype(np.uint8), kernel).astype(bool)


def cut(lab8: np.ndarray, hull: np.ndarray, odds: np.ndarray, band: int) -> np.ndarray:
    """GrabCut of one photo: sure object inside the hull, sure background outside its
    surroundings.
    """
    near = grow(hull, band)
    core = grow(hull, -band)
    if not core.any():
        return hull

    state = np.full(hull.shape, cv2.GC_BGD, np.uint8)
    state[near] = cv2.GC_PR_BGD
    state[near & (odds > 1.0)] = cv2.GC_PR_FGD
    state[hull & (odds > -2.0)] = cv2.GC_PR_FGD
    state[core & (odds > 0.3)] = cv2.GC_FGD

    rows, columns = np.where(grow(near, 3 * band))
    box = np.s_[rows.min() : rows.max() + 1, columns.min() : columns.max() + 1]
    cut_state = np.ascontiguousarray(state[box])
    picture = np.ascontiguousarray(lab8[box])
    background = np.zeros((1, 65))  # GrabCut's colour models
    foreground = np.zeros((1, 65))
    cv2.setRNGSeed(0)
    # OpenCV's stubs do not know that it may go without a rectangle
    cv2.grabCut(  # type: ignore[call-overload]
        picture, cut_state, None, background, foreground, 3, cv2.GC_INIT_WITH_MASK
    )

    out = np.zeros(hull.shape, bool)
    out[box] = (cut_state == cv2.GC_FGD) | (cut_state == cv2.GC_PR_FGD)
    return tidy(out)


def tidy(mask: np.ndarray) -> np.ndarray:
    """Smooth by two pixels, fill holes smaller than 3 % of the object, keep the large parts."""
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (5, 5))
    mask = cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_OPEN, kernel)
    mask = cv2.morphologyEx(mask, cv2.MORPH_CLOSE, kernel)

    for value in (0, 1):
        count, labels, stats, _ = cv2.connectedComponentsWithStats((mask == value).astype(np.uint8))
        area = stats[1:, cv2.CC_STAT_AREA]
        if count > 1:
            limit = 0.03 * mask.sum() if value == 0 else 0.08 * area.max()
            mask[np.isin(labels, 1 + np.where(area < limit)[0])] = 1 - value
    return mask.astype(bool)


def plane_masks(poses: Path, rig: Rig, settings: Masks, threads: int) -> tuple[dict, dict]:
    """Photo name -> mask (h, w) bool at the photos' size, and facts.

    Raises InputError when there is no ground plane, nothing stands out from it, or the masks of the
    photos contradict each other.
    """
    plane = rig.facts.get("plane")
    if plane is None:
        raise InputError(
            "no ground plane was found, so the object cannot be masked automatically",
            "masks",
            "put masks into the scene's folder masks/, or photograph on a textured table",
        )
    height = float(plane["offset"])

    labs = {
        v.name: to_lab(poses / v.image, working_size(v))
        for v in progress(rig.views, "photos to compare")
    }
    odds = _odds_of_all(rig, labs, height)
    points, cell = soft_hull(rig, odds, height)

    eight_bit = {
        name: np.clip(lab * [2.55, 1, 1] + [0, 128, 128], 0, 255).astype(np.uint8)
        for name, lab in labs.items()
    }
    for turn, band in ((1, 0.035), (2, 0.02)):
        masks = _cut_all(rig, eight_bit, odds, points, cell, band, threads, f"pass {turn}")
        points, cell = hull_points(rig, masks, 96, 0.15)
        if not len(points):
            raise InputError("the masks of the photos contradict each other", "masks", CURE)

    out = {}
    for v in rig.views:
        kept = masks[v.name] & grow(silhouette(v, points, cell, working_size(v)), 4)
        size = (v.width, v.height)
        out[v.name] = cv2.resize(kept.astype(np.float32), size, interpolation=cv2.INTER_CUBIC) > 0.5
    why = "no masks came with the photos; difference to the bare ground plane, GrabCut, hull"
    return out, {"why": why}


def working_size(view: View) -> tuple[int, int]:
    """(width, height) that a photo is compared at."""
    factor = min(1, WORKING / max(view.width, view.height))
    return round(view.width * factor), round(view.height * factor)


def _odds_of_all(rig: Rig, labs: dict[str, np.ndarray], height: float) -> dict[str, np.ndarray]:
    """Log-odds of every view, the object's footprint on the ground taken into account."""
    ground, spread = bare_ground(rig, labs, height)
    odds = {
        v.name: object_odds(v, rig, labs[v.name], ground, spread, height)
        for v in progress(rig.views, "difference to bare ground")
    }

    points, cell = soft_hull(rig, odds, height)
    if not len(points):
        what = "nothing above the ground plane stands out in the photos"
        raise InputError(what, "masks", CURE)

    below = footprint(rig, points, cell, spread)
    return {
        v.name: object_odds(v, rig, labs[v.name], ground, spread, height, below)
        for v in progress(rig.views, "with the footprint")
    }


def _cut_all(
    rig: Rig,
    pictures: dict[str, np.ndarray],
    odds: dict[str, np.ndarray],
    points: np.ndarray,
    cell: float,
    band: float,
    threads: int,
    note: str,
) -> dict[str, np.ndarray]:
    """GrabCut of every photo within `band` (fraction of the object's size) of the silhouette of the
    cells `points`; photo name -> mask (h, w) bool.
    """
    hulls = {v.name: silhouette(v, points, cell, working_size(v)) for v in rig.views}
    width = {n: max(3, round(band * np.sqrt(h.sum()) * 1.5)) for n, h in hulls.items()}
    with ThreadPoolExecutor(threads) as pool:
        jobs = {n: pool.submit(cut, pictures[n], hulls[n], odds[n], width[n]) for n in hulls}
        return {n: jobs[n].result() for n in progress(list(jobs), f"cut along edges, {note}")}
