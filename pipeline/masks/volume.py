"""The object in space: cells that the photos together hold for something above the ground, and
which of them are the object: the connected thing on which the cameras' axes converge.

Arrays: points (n, 3), centres of cubic cells of side `cell`; odds, log-odds images (h, w) > 0 for
object; given, the masks (h, w) bool that the user made, which are hard evidence.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np
from scipy import ndimage

from pipeline.geometry.cameras import Rig, View
from pipeline.geometry.voxels import Grid, sample, silhouette

SMALLEST_OTHER = 0.03  # share of the object's cells below which something is not worth a word
AIM = 0.25  # sphere radii by which a photographer's aim may scatter
AXIS_CELLS = 4000  # cells that a thing is represented by where axes are held against it


@dataclass
class Things:
    """What stands on the ground: the object's cells (n, 3) and their size; the cells of each other
    thing and theirs.
    """

    points: np.ndarray
    cell: float
    others: list[np.ndarray] = field(default_factory=list)
    others_cell: float = 0.0


def axis_distance(rig: Rig, points: np.ndarray) -> np.ndarray:
    """Distance (v, n) of points (n, 3) to every camera's optical axis."""
    out = np.empty((len(rig.views), len(points)))
    for k, view in enumerate(rig.views):
        away = points - view.position
        axis = view.world_to_camera[2, :3]
        along = away @ axis
        out[k] = np.sqrt(np.maximum((away**2).sum(1) - along**2, 0))
    return out


def _convergence(rig: Rig, points: np.ndarray) -> float:
    """How much the cameras' axes converge on a thing: its mean side in cells, times how near the
    axes come (Gaussian of AIM sphere radii).

    How near: the median over cameras at a cell, and the nearest twentieth of the thing's cells. A
    few axes that meet the thing on their way to the object do not count so.
    """
    step = max(1, len(points) // AXIS_CELLS)
    distance = np.median(axis_distance(rig, points[::step]), axis=0) / (AIM * rig.radius)
    nearest = np.percentile(distance, 5)
    return float(np.cbrt(len(points)) * np.exp(-0.5 * nearest**2))


def connected(points: np.ndarray, cell: float) -> list[np.ndarray]:
    """Cells of a regular grid in connected sets, largest first; gaps of up to two cells, which thin
    parts may have, do not separate.
    """
    if not len(points):
        return []
    at = np.round((points - points.min(0)) / cell).astype(int) + 1
    solid = np.zeros(at.max(0) + 2, bool)
    solid[tuple(at.T)] = True
    around = np.ones((3, 3, 3))
    labels, count = ndimage.label(ndimage.binary_dilation(solid, around), around)
    label = labels[tuple(at.T)]
    sets = [points[label == k] for k in range(1, count + 1)]
    return sorted(sets, key=len, reverse=True)


def the_object(rig: Rig, points: np.ndarray, cell: float, parts: str) -> Things:
    """The set of cells on which the axes converge, and the other sets. parts "all": everything that
    is not much smaller than the largest set belongs to the object.
    """
    sets = connected(points, cell)
    if not sets:
        return Things(np.zeros((0, 3)), cell)
    if parts == "all":
        kept = [s for s in sets if len(s) >= 0.15 * len(sets[0])]
        return Things(np.concatenate(kept), cell)

    chosen = int(np.argmax([_convergence(rig, s) for s in sets]))
    smallest = SMALLEST_OTHER * len(sets[chosen])
    others = [s for k, s in enumerate(sets) if k != chosen and len(s) >= smallest]
    return Things(sets[chosen], cell, others, cell)


def soft_hull(
    rig: Rig,
    odds: dict[str, np.ndarray],
    floor: float,
    given: dict[str, np.ndarray],
    parts: str,
    longest: int = 80,
) -> Things:
    """The things whose cells have a positive mean log-odds over views and few views against them.
    floor: height below which there is nothing.

    Two passes: over the scene's sphere, then over the object that the first pass found.
    """
    low = rig.center - rig.radius
    high = rig.center + rig.radius
    first = None
    for _ in range(2):
        low[1] = max(low[1], floor)
        grid = Grid.over(low, high, longest)
        points = grid.centers()
        solid = _solid(rig, odds, points) & inside_given(rig, given, points, grid.cell)
        solid |= _missing(rig, odds, given, points, solid, grid.cell)
        found = the_object(rig, points[solid], grid.cell, parts)
        if not len(found.points):
            return found

        first = first or found
        low = found.points.min(0) - 2 * grid.cell
        high = found.points.max(0) + 2 * grid.cell
    assert first is not None
    return Things(found.points, found.cell, first.others, first.others_cell)


def _total(
    rig: Rig, odds: dict[str, np.ndarray], points: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Per point (n,): sum of log-odds, views strongly against it, views whose frame holds it."""
    total = np.zeros(len(points))
    against = np.zeros(len(points))
    seen = np.zeros(len(points))
    for v in rig.views:
        value, inside = sample(v, odds[v.name], points)
        total += np.where(inside, value, 0)
        against += inside & (value < -1.5)
        seen += inside
    return total, against, seen


def _solid(rig: Rig, odds: dict[str, np.ndarray], points: np.ndarray) -> np.ndarray:
    """Which points (n, 3) the views together hold for object (n,)."""
    total, against, seen = _total(rig, odds, points)
    return (total > 0.4 * seen) & (against < 0.15 * seen) & (seen >= 0.5 * len(rig.views))


def inside_given(
    rig: Rig, given: dict[str, np.ndarray], points: np.ndarray, cell: float
) -> np.ndarray:
    """Which points (n, 3) no given mask speaks against (n,): a cell may reach over its edge."""
    kept = np.ones(len(points), bool)
    for v in rig.views:
        if v.name not in given:
            continue
        mask = given[v.name].astype(np.uint8)
        reach = _pixels(v, points, cell, mask.shape[1]) // 2
        wide = cv2.dilate(mask, np.ones((2 * reach + 1,) * 2, np.uint8))
        value, framed = sample(v, wide, points)
        kept &= (value > 0) | ~framed
    return kept


def _pixels(view: View, points: np.ndarray, cell: float, width: int) -> int:
    """Pixels that a cell covers in a picture of a view that is `width` wide, rounded up."""
    depth = np.median(view.project(points)[1])
    return max(1, int(np.ceil(cell * view.fx * width / view.width / max(depth, 1e-9))))


def _missing(
    rig: Rig,
    odds: dict[str, np.ndarray],
    given: dict[str, np.ndarray],
    points: np.ndarray,
    solid: np.ndarray,
    cell: float,
) -> np.ndarray:
    """Cells (n,) that given masks ask for: along each ray of such a mask that meets no solid cell,
    those for which the views say most.
    """
    out = np.zeros(len(points), bool)
    if not given:
        return out

    total, _, seen = _total(rig, odds, points)
    score = np.where(inside_given(rig, given, points, cell), total / np.maximum(seen, 1), -np.inf)
    for v in rig.views:
        if v.name not in given:
            continue
        side = _pixels(v, points, cell, given[v.name].shape[1])
        size = [max(1, s // side) for s in given[v.name].shape[1::-1]]
        small = cv2.resize(given[v.name].astype(np.float32), size, interpolation=cv2.INTER_AREA)
        met = silhouette(v, points[solid | out], cell, (size[0], size[1]))
        out |= _best_along_rays(v, points, score, (small > 0.5) & ~met)
    return out


def _best_along_rays(
    view: View, points: np.ndarray, score: np.ndarray, wanted: np.ndarray
) -> np.ndarray:
    """Cells (n,) with the best score behind each wanted pixel (h, w), and those nearly as good."""
    h, w = wanted.shape
    uv, depth = view.project(points)
    column = (uv[:, 0] * w / view.width).astype(int)
    row = (uv[:, 1] * h / view.height).astype(int)
    framed = (depth > 0) & (column >= 0) & (row >= 0) & (column < w) & (row < h)
    pixel = np.where(framed, row * w + column, 0)
    candidate = framed & wanted.ravel()[pixel] & np.isfinite(score)

    best = np.full(h * w, -np.inf)
    np.maximum.at(best, pixel[candidate], score[candidate])
    return candidate & (score >= best[pixel] - 0.1)


def nearest_depth(view: View, points: np.ndarray, cell: float, size: tuple[int, int]) -> np.ndarray:
    """Depth (h, w) of the nearest cell along each ray, infinite where there is none; `size` =
    (width, height).
    """
    w, h = size
    uv, depth = view.project(points)
    column = (uv[:, 0] * w / view.width).astype(int)
    row = (uv[:, 1] * h / view.height).astype(int)
    framed = (depth > 0) & (column >= 0) & (row >= 0) & (column < w) & (row < h)

    out = np.full(h * w, np.inf, np.float32)
    np.minimum.at(out, (row * w + column)[framed], depth[framed].astype(np.float32))
    reach = _pixels(view, points, cell, w)
    kernel = np.ones((2 * reach + 1,) * 2, np.uint8)
    return cv2.erode(out.reshape(h, w), kernel, borderValue=np.inf)


def hidden(view: View, things: Things, size: tuple[int, int]) -> np.ndarray:
    """Pixels (h, w) at which another thing stands before the object; `size` = (width, height)."""
    if not things.others:
        return np.zeros(size[::-1], bool)
    other = nearest_depth(view, np.concatenate(things.others), things.others_cell, size)
    return other < nearest_depth(view, things.points, things.cell, size)
