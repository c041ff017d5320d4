"""Masks without a network: what differs from the bare ground and does not lie on it, cut along
edges, held together by all views.

1. Evidence in every photo: colour unlike the bare ground (ground.py), and whether the pixel matches
   other photos on the ground or above it (sweep.py).
2. Colours of what is sure so far, object and ground, are evidence for the rest (colours.py).
3. A soft visual hull turns these log-odds into one volume; the object is the connected part of it
   on which the cameras' axes converge (volume.py). The rest is left out, and said so.
4. GrabCut between hull and background, twice, the second time with the hull of the first masks
   (cut.py).

Masks that came with some of the photos are hard evidence: nothing of the object lies outside them,
something of it lies behind every pixel of theirs, and their colours count for the other photos.
Then a ground plane is not needed.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import cv2
import numpy as np

from pipeline.base.config import Masks
from pipeline.base.errors import InputError
from pipeline.base.images import read_png
from pipeline.base.progress import progress
from pipeline.geometry.cameras import Rig, View
from pipeline.geometry.voxels import silhouette
from pipeline.masks.agreement import hull_points
from pipeline.masks.colours import Colours
from pipeline.masks.cut import cut_all, grow
from pipeline.masks.ground import (
    bare_ground,
    footprint,
    ground_odds,
    pixel_ground,
    seen_ground,
    sphere_region,
    to_lab,
    working_size,
)
from pipeline.masks.sweep import ground_or_above
from pipeline.masks.volume import Things, axis_distance, hidden, soft_hull, the_object

CURE = "put masks into the scene's folder masks/"
SURE = 2.0  # log-odds from which on a pixel's side counts as known
HARD = 8.0  # log-odds of a pixel that the user has masked
FEW = 95  # percentile of a photo's lightness above which lie highlights and lamps
BELOW = 0.6  # least log-odds by colour of a ray that ends below the object
COLOUR = 1.5, 2.5  # largest log-odds by colour, learned from the photos and from given masks


def plane_masks(poses: Path, rig: Rig, settings: Masks, threads: int) -> tuple[dict, dict]:
    """Photo name -> mask (h, w) bool at the photos' size, and facts.

    Raises InputError when there is neither a ground plane nor a given mask, nothing stands out from
    the ground, or the masks of the photos contradict each other.
    """
    plane = rig.facts.get("plane")
    given = some_given(poses, rig)
    if plane is None and not given:
        raise _without_ground(rig)
    height = None if plane is None else float(plane["offset"])

    labs = {
        v.name: to_lab(poses / v.image, working_size(v))
        for v in progress(rig.views, "photos to compare")
    }
    things, odds = find_object(rig, labs, height, given, settings.parts, threads)
    masks = cut_masks(rig, labs, odds, things, given, threads)
    return masks, _facts(rig, things, given, plane is not None)


def _without_ground(rig: Rig) -> InputError:
    """What to tell the user where neither a ground nor a mask says what the object is."""
    known = rig.facts.get("no_ground", {})
    why = f": {known['why']}" if known else ""
    return InputError(
        f"no ground plane was found, so the object cannot be masked automatically{why}",
        "masks",
        "put a mask of one or more photos into the scene's folder masks/, or "
        + known.get("cure", "photograph on a textured table"),
    )


def some_given(poses: Path, rig: Rig) -> dict[str, np.ndarray]:
    """The user's masks (h, w) bool at working size, of the photos that have one."""
    out = {}
    for v in rig.views:
        file = poses / "masks" / f"{v.name}.png"
        if file.exists():
            mask = (read_png(file) > 127).astype(np.float32)
            out[v.name] = cv2.resize(mask, working_size(v), interpolation=cv2.INTER_AREA) > 0.5
    return out


def find_object(
    rig: Rig,
    labs: dict[str, np.ndarray],
    height: float | None,
    given: dict[str, np.ndarray],
    parts: str,
    threads: int,
) -> tuple[Things, dict[str, np.ndarray]]:
    """The object's volume and what stands beside it, and every view's log-odds (h, w)."""
    # a given mask may say that the object reaches below a ground that was found too high
    floor = -np.inf if height is None or given else height
    hull = lambda odds: soft_hull(rig, with_given(rig, odds, given), floor, given, parts)

    odds = {
        v.name: np.where(sphere_region(v, rig, working_size(v)), 0, -4).astype(np.float32)
        for v in rig.views
    }
    if height is not None:
        odds = _against_ground(rig, labs, height, hull, threads)
    odds = _with_colours(rig, labs, odds, given)
    things = hull(odds)
    if not len(things.points):
        what = "nothing above the ground plane stands out in the photos"
        raise InputError(what, "masks", CURE)
    return things, with_given(rig, odds, given)


def _against_ground(
    rig: Rig,
    labs: dict[str, np.ndarray],
    height: float,
    hull: Callable[[dict[str, np.ndarray]], Things],
    threads: int,
) -> dict[str, np.ndarray]:
    """Every view's log-odds (h, w) by matching and by colour. The bare ground is looked at twice,
    the second time past the volume that the first time has shown.
    """
    matched = _of_all(
        rig, lambda k: ground_or_above(rig, k, labs, height), threads, "ground or above it"
    )
    covered = {n: grow(o > 1, 3) for n, o in matched.items()}
    colour, spread = _unlike_ground(rig, labs, height, covered, threads, "difference to ground")
    first = hull(_sum(rig, matched, colour))
    if not len(first.points):
        return _sum(rig, matched, colour)

    for v in rig.views:
        covered[v.name] |= grow(silhouette(v, first.points, first.cell, working_size(v)), 3)
    colour, spread = _unlike_ground(rig, labs, height, covered, threads, "past the object")
    below = footprint(rig, first.points, first.cell, spread)
    colour = {v.name: _above(v, rig, height, below, colour[v.name]) for v in rig.views}
    return _sum(rig, matched, colour)


def _unlike_ground(
    rig: Rig,
    labs: dict[str, np.ndarray],
    height: float,
    covered: dict[str, np.ndarray],
    threads: int,
    label: str,
) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Every view's log-odds (h, w) by the colour of the bare ground, and how much that changes
    between views (t, t).
    """
    ground, spread = bare_ground(rig, labs, height, covered)
    by_colour = lambda k: ground_odds(
        rig.views[k], rig, labs[rig.views[k].name], ground, spread, height
    )
    return _of_all(rig, by_colour, threads, label), spread


def _of_all(
    rig: Rig, function: Callable[[int], np.ndarray], threads: int, label: str
) -> dict[str, np.ndarray]:
    """`function` of every view's index, by the view's name."""
    with ThreadPoolExecutor(threads) as pool:
        jobs = [pool.submit(function, k) for k in range(len(rig.views))]
        return {v.name: job.result() for v, job in zip(rig.views, progress(jobs, label))}


def _sum(
    rig: Rig, matched: dict[str, np.ndarray], colour: dict[str, np.ndarray]
) -> dict[str, np.ndarray]:
    """Evidence by matching and by colour; nothing of the object is outside its sphere."""
    out = {}
    for v in rig.views:
        inside = sphere_region(v, rig, working_size(v))
        both = matched[v.name] + 0.7 * colour[v.name]
        out[v.name] = np.where(inside, np.clip(both, -4, 4), -4).astype(np.float32)
    return out


def _above(view: View, rig: Rig, height: float, below: np.ndarray, odds: np.ndarray) -> np.ndarray:
    """Odds by colour of a view: a ray that ends below the object has most likely met it."""
    at = pixel_ground(view, rig, height, working_size(view))
    under = seen_ground(below.astype(np.float32), at) > 0.5
    return np.where(under, np.maximum(odds, BELOW), odds).astype(np.float32)


def _with_colours(
    rig: Rig,
    labs: dict[str, np.ndarray],
    odds: dict[str, np.ndarray],
    given: dict[str, np.ndarray],
) -> dict[str, np.ndarray]:
    """Odds (h, w) of every view plus those that its colours have by the other pixels: by those
    whose side is sure, and by the given masks.
    """
    near = {v.name: sphere_region(v, rig, working_size(v)) for v in rig.views}
    models = [
        Colours(
            labs,
            {n: o > SURE for n, o in odds.items()},
            {n: (o < -SURE) & near[n] for n, o in odds.items()},
            COLOUR[0],
        ),
        Colours(labs, given, {n: ~m & near[n] for n, m in given.items()}, COLOUR[1]),
    ]
    out = {}
    for n, o in odds.items():
        more = sum((m.odds(labs[n]) for m in models if m.known), np.zeros_like(o))
        out[n] = np.where(near[n], np.clip(o + more, -4, 4), -4).astype(np.float32)
    return out


def with_given(
    rig: Rig, odds: dict[str, np.ndarray], given: dict[str, np.ndarray]
) -> dict[str, np.ndarray]:
    """Odds of every view, those of given masks hard."""
    hard = {n: np.where(m, HARD, -HARD).astype(np.float32) for n, m in given.items()}
    return {v.name: hard.get(v.name, odds[v.name]) for v in rig.views}


def cut_masks(
    rig: Rig,
    labs: dict[str, np.ndarray],
    odds: dict[str, np.ndarray],
    things: Things,
    given: dict[str, np.ndarray],
    threads: int,
) -> dict[str, np.ndarray]:
    """Photo name -> mask (h, w) bool at the photos' size, cut along edges near the object's hull.

    What other things hide counts as object where masks vote for a volume, and is not in a mask.
    """
    eight_bit = in_eight_bits(labs)
    points = things.points
    cell = things.cell
    behind = {v.name: hidden(v, things, working_size(v)) for v in rig.views}
    for turn, band in ((1, 0.035), (2, 0.02)):
        hulls = {v.name: silhouette(v, points, cell, working_size(v)) for v in rig.views}
        masks = cut_all(eight_bit, hulls, odds, band, threads, f"pass {turn}") | given
        votes = {n: given.get(n, m | (behind[n] & hulls[n])) for n, m in masks.items()}
        points, cell = hull_points(rig, votes, 96, 0.15, given)
        points = the_object(rig, points, cell, "one").points if things.others else points
        if not len(points):
            raise InputError("the masks of the photos contradict each other", "masks", CURE)

    out = {}
    for v in rig.views:
        near = grow(silhouette(v, points, cell, working_size(v)), 4)
        kept = given.get(v.name, masks[v.name] & near & ~behind[v.name]).astype(np.float32)
        out[v.name] = cv2.resize(kept, (v.width, v.height), interpolation=cv2.INTER_CUBIC) > 0.5
    return out


def in_eight_bits(labs: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Photos in CIELAB as uint8 (h, w, 3): 255 is white, or what few pixels of most photos exceed
    where that is brighter.
    """
    top = max(100.0, float(np.median([np.percentile(lab[..., 0], FEW) for lab in labs.values()])))
    scale = [255 / top, 1, 1]
    return {
        name: np.clip(lab * scale + [0, 128, 128], 0, 255).astype(np.uint8)
        for name, lab in labs.items()
    }


def _facts(rig: Rig, things: Things, given: dict[str, np.ndarray], plane: bool) -> dict:
    """What was decided, in words and figures."""
    evidence = ["difference to the bare ground plane", "matching on it and above it"]
    if not plane:
        evidence = ["no ground plane"]
    if given:
        evidence.append(f"masks of {len(given)} photos")
    hides = [v.name for v in rig.views if _share_hidden(v, things) > 0.03]
    distance = np.median(axis_distance(rig, things.points).min(1))
    return {
        "why": "not every photo came with a mask; " + ", ".join(evidence) + ", GrabCut, hull",
        "given": sorted(given),
        "others": [describe(things.points, other) for other in things.others],
        "hidden_in": hides,
        "axes_miss_by": float(distance / rig.radius),
    }


def _share_hidden(view: View, things: Things) -> float:
    """Share of the object's silhouette before which another thing stands."""
    size = working_size(view)
    whole = silhouette(view, things.points, things.cell, size)
    return float((hidden(view, things, size) & whole).sum() / max(whole.sum(), 1))


def describe(points: np.ndarray, other: np.ndarray) -> dict:
    """Another thing against the object, by their cells (n, 3) and (m, 3): its longest side, and its
    middle's distance from the object's, both over the object's longest side.
    """
    extent = np.ptp(points, axis=0).max()
    return {
        "size": float(np.ptp(other, axis=0).max() / extent),
        "distance": float(np.linalg.norm(other.mean(0) - points.mean(0)) / extent),
    }
