"""What the bare ground looks like, and what differs from it.

1. Warp every photo onto the ground plane; the median over views is the ground without the object,
   shadows included, because they do not move.
2. What differs from it, above 1.6 times the 95th percentile of the differences outside the object's
   sphere, is object; rays that miss the known ground say nothing.

Frame: Y-up, ground at y = height. Arrays: lab, a photo in CIELAB (h, w, 3); ground (t, t, 3) and
spread (t, t), the ground's colour and how much it changes from view to view, t = TEXTURE; odds,
log-odds (h, w) in [-3, 3] that a pixel shows the object.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from scipy import ndimage

from pipeline.base.images import linear_to_srgb, read_exr
from pipeline.geometry.cameras import Rig, View
from pipeline.geometry.voxels import sample
from pipeline.masks.cut import grow

WORKING = 600  # long side in pixels
TEXTURE = 512  # texels along the ground's side
EXTENT = 3.5  # half-side of the known ground in object radii
PART = 16384  # texels of the ground that all views are held in memory of at a time
UNKNOWN = 99  # spread of ground that too few views have seen


def working_size(view: View) -> tuple[int, int]:
    """(width, height) that a photo is compared at."""
    factor = min(1, WORKING / max(view.width, view.height))
    return round(view.width * factor), round(view.height * factor)


def to_lab(path: Path, size: tuple[int, int]) -> np.ndarray:
    """Photo as CIELAB float32 (h, w, 3). Its lightness goes on above 100: what is brighter than the
    scene's white (pipeline/photos/radiance.py) is not all one colour.
    """
    return lab_of(cv2.resize(read_exr(path), size, interpolation=cv2.INTER_AREA))


def lab_of(linear: np.ndarray) -> np.ndarray:
    """CIELAB of linear RGB (h, w, 3), white 1, without an upper end.

    OpenCV's ends at 1. A brighter pixel is k times one whose largest channel is 1, and there
    L + 16, a and b are proportional to the cube root of k.
    """
    over = np.maximum(linear.max(-1, keepdims=True), 1).astype(np.float32)
    lab = cv2.cvtColor(linear_to_srgb(linear / over), cv2.COLOR_RGB2Lab)
    black = np.array([16, 0, 0], np.float32)
    return np.where(over > 1, (lab + black) * np.cbrt(over) - black, lab)


def ground_points(rig: Rig, height: float) -> np.ndarray:
    """(TEXTURE, TEXTURE, 3) points of the plane y = height around the object."""
    axis = np.linspace(-1, 1, TEXTURE) * EXTENT * rig.radius
    x, z = np.meshgrid(axis + rig.center[0], axis + rig.center[2], indexing="xy")
    return np.stack([x, np.full_like(x, height), z], -1)


def bare_ground(
    rig: Rig, labs: dict[str, np.ndarray], height: float, covered: dict[str, np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Median colour (t, t, 3) over views and its spread (t, t); NaN where fewer than four views
    look. covered: pixels (h, w) bool that show something before the ground and do not count.
    """
    points = ground_points(rig, height).reshape(-1, 3)
    hides = {v.name: covered[v.name].astype(np.uint8) for v in rig.views}
    parts = [
        _bare_part(rig, labs, hides, points[k : k + PART]) for k in range(0, len(points), PART)
    ]
    median, spread = (np.concatenate(part) for part in zip(*parts))
    return median.reshape(TEXTURE, TEXTURE, 3), spread.reshape(TEXTURE, TEXTURE)


def _bare_part(
    rig: Rig, labs: dict[str, np.ndarray], hides: dict[str, np.ndarray], points: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """As `bare_ground`, of some of its points (n, 3): median (n, 3) and spread (n,). hides:
    `covered` as uint8.
    """
    stack = np.full((len(rig.views), len(points), 3), np.nan, np.float32)
    for k, v in enumerate(rig.views):
        value, inside = sample(v, labs[v.name], points, interpolate=True)
        before, _ = sample(v, hides[v.name], points)
        bare = inside & (before == 0)
        stack[k, bare] = value[bare]
    median, spread, seen = _median_and_spread(stack)

    # seen from above, little ground hides behind the object: these views count alone where they can
    flatness = [-v.position[1] / np.linalg.norm(v.position - rig.center) for v in rig.views]
    steep = stack[np.argsort(flatness)[: max(6, round(0.35 * len(rig.views)))]]
    enough = np.isfinite(steep[..., 0]).sum(0) >= 4
    median[enough], spread[enough], _ = _median_and_spread(steep[:, enough])

    median[seen < 4] = np.nan
    spread[seen < 4] = np.nan
    return median, spread


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
    """Pixels (h, w) whose ray passes within 1.1 radii of the object's centre.

    Of a ray r = (x, y, 1) from the camera and the centre c in its frame, the squared distance is
    |c|^2 - (r c)^2 / |r|^2, in which r c and |r|^2 are sums of a column's part and a row's.
    """
    w, h = size
    x = ((np.arange(w) + 0.5) * view.width / w - view.cx) / view.fx
    y = ((np.arange(h) + 0.5) * view.height / h - view.cy) / view.fy
    center = view.world_to_camera[:3] @ np.append(rig.center, 1)
    along = np.add.outer(center[1] * y, center[0] * x + center[2])
    square = np.add.outer(y**2, x**2 + 1)
    return center @ center - along**2 / square < (1.1 * rig.radius) ** 2


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
    weights = np.diag([0.7, 1.3, 1.3])
    lab = cv2.transform(lab, weights)
    ground = cv2.transform(ground, weights)

    out = np.full(lab.shape[:2], np.inf, np.float32)
    for dy in (-1, 0, 1):
        for dx in (-1, 0, 1):
            apart = lab - np.roll(ground, (dy, dx), (0, 1))
            out = np.minimum(out, np.einsum("ijk,ijk->ij", apart, apart))
    return np.sqrt(out)


def ground_odds(
    view: View, rig: Rig, lab: np.ndarray, ground: np.ndarray, spread: np.ndarray, height: float
) -> np.ndarray:
    """Log-odds (h, w) in [-3, 3] that a pixel shows the object, from its difference to the bare
    ground; 0 where the ray misses the known ground.
    """
    at = pixel_ground(view, rig, height, lab.shape[1::-1])
    known = np.isfinite(at[..., 0])
    hole = np.isnan(ground[..., 0])
    unsure = seen_ground(np.where(hole, UNKNOWN, spread).astype(np.float32), at)
    known &= ~(seen_ground(hole.astype(np.float32), at) > 0)
    difference = _difference(lab, seen_ground(np.where(hole[..., None], 0, ground), at))

    outside = known & ~sphere_region(view, rig, lab.shape[1::-1]) & (unsure < 20)
    threshold = 1.6 * np.percentile(difference[outside], 95) if outside.sum() > 500 else 25.0
    threshold = float(np.clip(threshold, 8, 40))
    odds = np.clip(3 * (difference - threshold) / threshold, -3, 3)
    odds = odds / (1 + np.maximum(unsure - 6, 0) / 6)  # a ground that changes says little
    return np.where(known, cv2.blur(odds.astype(np.float32), (3, 3)), 0).astype(np.float32)


def seen_ground(texture: np.ndarray, at: np.ndarray) -> np.ndarray:
    """A texture of the ground (t, t) or (t, t, c) as a view sees it; `at`: of `pixel_ground`."""
    missed = np.isnan(at[..., 0])
    x = np.where(missed, -1, at[..., 0])
    y = np.where(missed, -1, at[..., 1])
    return cv2.remap(texture, x, y, cv2.INTER_LINEAR)
