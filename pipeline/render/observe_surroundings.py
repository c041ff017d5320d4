"""Find in the photos what lies around the object (surroundings.py).

The ground: the plane on which structure from motion stood the scene. Every texel is looked up in
all photos, less the pixels of the object's mask, and has their median. Where photos do not agree
there is something else than ground, and it ends.

Views past the object: directions above the horizon, for below it a camera sees another part of the
ground than the object does. Light is distant where photos from apart see the same radiance in the
same direction: what stands near shows itself elsewhere in each.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from scipy import ndimage

from pipeline.base.config import Observe
from pipeline.base.images import luminance, read_exr, read_png
from pipeline.base.progress import progress
from pipeline.geometry.cameras import Rig, View
from pipeline.geometry.mesh_io import load_mesh
from pipeline.photos.saturation import saturated
from pipeline.render.envmap import directions, uv_from_direction
from pipeline.render.surroundings import SIGHT_ROWS, Around, Ground, Sightings, Surroundings
from pipeline.render.tint import tint_of

WORKING = 480  # long side in pixels that photos are looked up at
MARGIN = 0.012  # of that: how far from the mask a pixel shows nothing of the object
TEXELS = 128  # along the ground's side
EXTENT = 4.0  # radius of the ground in object radii
FEWEST_VIEWS = 3  # that see a texel
DISAGREEMENT = 0.35  # relative deviation between photos from which on it is no ground
NEAR, ENOUGH = 1.5, 0.3  # within so many radii, at least so much of the ground is seen
SINK = 2e-3  # of the object's radius: the ground lies so far below its lowest point
BLACK = 1e-3  # mean radiance below which photos show no surroundings at all
SHOWN = 0.02  # of the photos' pixels: fewer beside the object say nothing of the rest
DIM = 0.05  # of the object's radiance: darker surroundings are black cloth, which hides the light
SHADE = 0.02  # radiance below which disagreement counts absolutely
ERROR = 0.3  # relative error of a sighting: the camera stands elsewhere than the object
APART = 1.0  # object radii between the rays of two photos that agree on a distant radiance
FEWEST_PIXELS = 4  # of a photo in a cell of the table


@dataclass(frozen=True)
class Look:
    """A photo at working size: linear (h, w, 3), what of it is saturated, and which pixels show the
    surroundings, (h, w) each.
    """

    view: View
    photo: np.ndarray
    clipped: np.ndarray
    around: np.ndarray

    @classmethod
    def at(cls, view: View, poses: Path, masks: Path) -> Look:
        """A view's photo and mask."""
        small = view.scaled(min(1.0, WORKING / max(view.width, view.height)))
        size = (small.width, small.height)
        photo = read_exr(poses / view.image)
        full = saturated(poses, view, photo).any(-1).astype(np.float32)
        mask = read_png(masks / "masks" / f"{view.name}.png")
        shrink = lambda image: cv2.resize(image, size, interpolation=cv2.INTER_AREA)
        margin = 1 + round(MARGIN * max(size))
        kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * margin + 1,) * 2)
        object_ = cv2.dilate((shrink(mask) > 0).astype(np.uint8), kernel)
        return cls(small, shrink(photo), shrink(full) > 0, object_ == 0)


def find_surroundings(
    rig: Rig,
    views: list[View],
    poses: Path,
    masks: Path,
    mesh: Path,
    settings: Observe,
    stops: dict[str, np.ndarray] | None = None,
) -> tuple[Surroundings, dict]:
    """What `views` show around the object, as far as `settings` ask for it, and facts. stops: log2
    gains (3,) to divide photos by, by the view's name.
    """
    if not (settings.ground or settings.background or settings.tint):
        return Surroundings(), {}

    looks = [Look.at(view, poses, masks) for view in progress(views, "surroundings")]
    if stops:
        gain = lambda look: 2 ** stops[look.view.name].astype(np.float32)
        looks = [replace(look, photo=look.photo / gain(look)) for look in looks]
    shown = [look.photo[look.around] for look in looks if look.around.any()]
    if not shown or np.concatenate(shown).mean() < BLACK:
        return Surroundings(), {"surroundings": "none: the photos show nothing but the object"}

    around, of_tint = find_around(looks) if settings.tint else (None, {})
    if not (settings.ground or settings.background):
        return Surroundings(around=around), of_tint

    surface = load_mesh(mesh).vertices
    rig = rig.holding(surface)
    plane = rig.facts.get("plane")
    ground, sightings = None, None
    facts = of_tint
    if settings.ground:
        bottom = float(surface[:, 1].min())
        ground, of_ground = find_ground(rig, looks, plane, bottom)
        facts |= of_ground
    if ground is not None:
        sightings = floor(ground, rig.center)
    if settings.background:
        far, of_far = find_sightings(rig, looks, plane is not None)
        sightings = far if sightings is None else far.beside(sightings)
        facts |= of_far
    return Surroundings(ground, sightings, around), facts


def find_around(looks: list[Look]) -> tuple[Around | None, dict]:
    """The mean of what the photos show beside the object, and facts: its tint, or why there is
    none. A saturated pixel counts with its level.
    """
    if np.mean([look.around.mean() for look in looks]) < SHOWN:
        return None, {"tint_around": "none: the object fills the photos"}
    beside = np.concatenate([look.photo[look.around] for look in looks]).mean(0, dtype=float)
    object_ = np.concatenate([look.photo[~look.around] for look in looks])
    if beside.min() <= 0 or (len(object_) and beside.mean() < DIM * object_.mean()):
        return None, {"tint_around": "none: the photos are all but black around the object"}
    return Around(beside), {"tint_around": tint_of(beside).tolist()}


def find_ground(
    rig: Rig, looks: list[Look], plane: dict | None, bottom: float
) -> tuple[Ground | None, dict]:
    """The ground below the object, whose lowest point lies at `bottom`, and facts: why there is
    none, or how much of it was seen and filled.
    """
    if plane is None:
        return None, {"ground": "none: no plane was found below the object"}
    height = float(plane["offset"])
    if abs(bottom - height) > 0.2 * rig.radius:
        return None, {"ground": "none: the object does not stand on the plane"}

    texel = 2 * EXTENT * rig.radius / TEXELS
    corner = rig.center[[0, 2]] - EXTENT * rig.radius
    blank = np.zeros((TEXELS, TEXELS))
    low = min(height, bottom) - SINK * rig.radius
    ground = Ground(low, corner, texel, np.stack([blank] * 3, -1), blank > 0)

    radiance, seen = texel_medians(ground, looks)
    distance = np.linalg.norm(texel_centres(ground) - rig.center, axis=-1) / rig.radius
    seen &= (distance < EXTENT).reshape(seen.shape)
    near = (distance < NEAR).reshape(seen.shape)
    if seen[near].mean() < ENOUGH:
        return None, {"ground": "none: the photos do not agree on it", "seen": seen[near].mean()}

    known = middle_part(seen)
    nearest = ndimage.distance_transform_edt(~seen, return_indices=True)[1]
    radiance = radiance[tuple(nearest)].astype(np.float32)
    facts = {
        "ground": "seen",
        "ground_extent": float(np.sqrt(known.mean() * (2 * EXTENT) ** 2 / np.pi)),
        "ground_filled_share": float((known & ~seen).sum() / known.sum()),
    }
    return replace(ground, radiance=radiance, known=known), facts


def texel_centres(ground: Ground) -> np.ndarray:
    """(t t, 3) points of the plane, row by row."""
    axis = (np.arange(TEXELS) + 0.5) * ground.texel
    x, z = np.meshgrid(ground.corner[0] + axis, ground.corner[1] + axis)
    return np.stack([x, np.full_like(x, ground.height), z], -1).reshape(-1, 3)


def texel_medians(ground: Ground, looks: list[Look]) -> tuple[np.ndarray, np.ndarray]:
    """Median radiance (t, t, 3) over the photos, and where enough of them see it and agree (t, t).
    Of a saturated pixel its level counts, so bright ground comes out as bright as it can be shown.
    """
    points = texel_centres(ground)
    stack = np.full((len(looks), len(points), 3), np.nan, np.float32)
    for values, look in zip(stack, looks):
        at, depth = look.view.project(points)
        column, row = np.floor(np.clip(at, -1, 1e6)).astype(int).T
        inside = (depth > 0) & (row >= 0) & (row < look.view.height)
        inside &= (column >= 0) & (column < look.view.width)
        inside[inside] = look.around[row[inside], column[inside]]
        values[inside] = look.photo[row[inside], column[inside]]

    enough = np.isfinite(stack[..., 0]).sum(0) >= FEWEST_VIEWS
    median = np.zeros((len(points), 3), np.float32)
    spread = np.full(len(points), np.inf)
    median[enough] = np.nanmedian(stack[:, enough], 0)
    brightness = luminance(stack[:, enough])
    middle = luminance(median[enough])
    spread[enough] = np.nanmedian(np.abs(brightness - middle), 0) / (middle + SHADE)

    agree = ndimage.median_filter((spread < DISAGREEMENT).reshape(TEXELS, TEXELS), 3)
    return median.reshape(TEXELS, TEXELS, 3), agree & enough.reshape(TEXELS, TEXELS)


def middle_part(seen: np.ndarray) -> np.ndarray:
    """The largest connected part of the texels (t, t), its holes filled: below the object too."""
    number, _ = ndimage.label(seen)
    largest = np.bincount(number[seen]).argmax()
    return ndimage.binary_fill_holes(number == largest)


def floor(ground: Ground, centre: np.ndarray) -> Sightings:
    """The ground as the light that the object's centre (3,) sees from below."""
    cells = directions(SIGHT_ROWS, 2 * SIGHT_ROWS).reshape(-1, 3)
    met, radiance = ground.seen(np.broadcast_to(centre, cells.shape), cells)
    shape = (SIGHT_ROWS, 2 * SIGHT_ROWS)
    return Sightings(
        radiance.reshape(*shape, 3).astype(np.float32),
        np.where(met, ERROR, np.inf).reshape(shape),
        np.zeros(shape, bool),
    )


def find_sightings(rig: Rig, looks: list[Look], above: bool) -> tuple[Sightings, dict]:
    """Cells of the light that photos apart agree on, and facts. above: over the horizon only."""
    cells = 2 * SIGHT_ROWS**2
    mean = np.full((len(looks), cells, 3), np.nan, np.float32)
    clipped = np.zeros((len(looks), cells), bool)
    for k, look in enumerate(looks):
        mean[k], clipped[k] = cell_means(look, above)

    seen = np.isfinite(mean[..., 0])
    some = np.flatnonzero(seen.sum(0) >= 2)
    radiance = np.zeros((cells, 3), np.float32)
    deviation = np.full(cells, np.inf)
    positions = np.stack([look.view.position for look in looks])
    direction = directions(SIGHT_ROWS, 2 * SIGHT_ROWS).reshape(-1, 3)
    for cell in some:
        mine = seen[:, cell]
        if baseline(positions[mine], direction[cell]) < APART * rig.radius:
            continue
        values = mean[mine, cell]
        radiance[cell] = np.median(values, 0)
        middle = luminance(radiance[cell])
        # saturated photos agree on being bright: only what darker ones say is a contradiction
        spread = np.abs(luminance(values) - middle).mean() / (middle + SHADE)
        if spread < DISAGREEMENT:
            deviation[cell] = np.hypot(ERROR, spread)

    shape = (SIGHT_ROWS, 2 * SIGHT_ROWS)
    found = Sightings(
        radiance.reshape(*shape, 3),
        deviation.reshape(shape),
        (clipped.any(0) & np.isfinite(deviation)).reshape(shape),
    )
    return found, {
        "background_share_of_sphere": float(sphere_share(np.isfinite(found.deviation))),
        "background_clipped_share": float(sphere_share(found.clipped)),
        "background_refused_share": float(sphere_share((seen.sum(0) >= 2).reshape(shape)))
        - float(sphere_share(np.isfinite(found.deviation))),
    }


def cell_means(look: Look, above: bool) -> tuple[np.ndarray, np.ndarray]:
    """Mean radiance (cells, 3) of a photo's pixels around the object in every cell of the table,
    NaN where there are too few, and which cells hold a saturated pixel (cells,).
    """
    rows, columns = np.nonzero(look.around)
    _, direction = look.view.rays(np.stack([columns + 0.5, rows + 0.5], -1))
    if above:
        up = direction[:, 1] > 0
        rows, columns, direction = rows[up], columns[up], direction[up]

    cells = 2 * SIGHT_ROWS**2
    uv = uv_from_direction(direction)
    row = np.minimum((uv[:, 1] * SIGHT_ROWS).astype(int), SIGHT_ROWS - 1)
    cell = row * 2 * SIGHT_ROWS + (uv[:, 0] * 2 * SIGHT_ROWS).astype(int) % (2 * SIGHT_ROWS)
    count = np.bincount(cell, minlength=cells)
    pixels = look.photo[rows, columns]
    sums = np.stack([np.bincount(cell, pixels[:, c], cells) for c in range(3)], -1)
    mean = np.where(count[:, None] >= FEWEST_PIXELS, sums / np.maximum(count, 1)[:, None], np.nan)
    return mean, np.bincount(cell, look.clipped[rows, columns], cells) > 0


def baseline(positions: np.ndarray, direction: np.ndarray) -> float:
    """Largest distance between parallel rays (k, 3) along one unit direction (3,)."""
    across = positions - (positions @ direction)[:, None] * direction
    return float(np.linalg.norm(across[:, None] - across[None], axis=-1).max())


def sphere_share(cells: np.ndarray) -> np.floating:
    """Share of the sphere that cells (h, 2h) cover."""
    rows = np.cos(np.pi * ((np.arange(len(cells)) + 0.5) / len(cells) - 0.5))
    return (cells.mean(1) * rows).sum() / rows.sum()
