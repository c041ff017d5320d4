"""Photos that say nothing new: doubles of a burst, and frames blurred by motion or focus.

Doubles: two photos whose content moved by less than `STILL` between them show the same rays. Of
each group the sharpest stays.

Blur: how much fine structure a picture has depends on what it shows, so a photo is held against
those taken just before and after it, by two measures that fail in different cases: the energy of
the Laplacian, which falls where an empty wall enters the frame; and the energy of the gradient over
that of the blurred picture, in textured tiles, which does not, but rises with noise. Both have to
fall. It finds strong blur (9 pixels of 1000 and more) and lets weak blur pass.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import cv2
import numpy as np

from pipeline.base.images import linear_to_srgb, luminance
from pipeline.photos.focus import edge_width

LARGE = 1000  # pixels along the long side that sharpness is measured at
SMALL = 256  # pixels along the long side that motion is measured at
TINY = 32  # side of the square that finds pairs worth comparing
STILL = 0.5  # pixels of SMALL: 0.12 degrees in a field of view of 60
ALIKE = 0.995  # correlation of TINY pictures below which two photos are not doubles
TILES = 8  # tiles along each side for motion
NEIGHBOURS = 4  # photos before and after
LOSS = 2.2  # log2, both measures together; unblurred photos of real sets lose up to 2.1
LEAST_LOSS = 0.5  # log2, each of them
FEWEST = 12  # photos from which a blurred one can be spared
MOST = 0.2  # share of the photos that blur may take away, the worst first
DOUBLED = "they show the same as another (burst)"
BLURRED = "blurred against the photos before and after"

# why a photo is left out, and the photo that it doubles
Reason: TypeAlias = tuple[str, int | None]


@dataclass
class Look:
    """What is kept of a photo to compare it: small (h, w) and tiny (TINY, TINY) grey pictures;
    energy and detail, both log2; edge: width of the steepest edges, in pixels of a picture with
    at most LARGE.
    """

    small: np.ndarray
    tiny: np.ndarray
    energy: float
    detail: float
    edge: float


def look_at(linear: np.ndarray) -> Look:
    """Measure a photo (h, w, 3), linear. Brightness as a whole does not count."""
    grey = linear_to_srgb(luminance(linear))
    grey = grey / max(float(grey.mean()), 1e-3)
    large = _at_most(grey, LARGE)
    small = _at_most(grey, SMALL)
    tiny = cv2.resize(small, (TINY, TINY), interpolation=cv2.INTER_AREA)
    tiny = tiny - tiny.mean()
    return Look(
        small,
        tiny / max(float(np.linalg.norm(tiny)), 1e-6),
        _energy(large),
        _detail(large),
        edge_width(large),
    )


def _at_most(grey: np.ndarray, side: int) -> np.ndarray:
    """The picture with its long side at most `side` pixels."""
    factor = side / max(grey.shape)
    if factor >= 1:
        return grey
    size = (max(1, round(grey.shape[1] * factor)), max(1, round(grey.shape[0] * factor)))
    return cv2.resize(grey, size, interpolation=cv2.INTER_AREA)


def _energy(grey: np.ndarray) -> float:
    """log2 of the Laplacian's variance, after a slight blur against noise."""
    smooth = cv2.GaussianBlur(grey, (0, 0), 0.7)
    return float(np.log2(cv2.Laplacian(smooth, cv2.CV_32F).var() + 1e-9))


def _gradient(grey: np.ndarray) -> np.ndarray:
    """Squared gradient (h - 1, w - 1)."""
    return np.diff(grey, axis=1)[:-1] ** 2 + np.diff(grey, axis=0)[:, :-1] ** 2


def _detail(grey: np.ndarray) -> float:
    """log2 of the gradient's energy over that after a blur by 2 pixels, in the quarter of the tiles
    with most texture: the 75th percentile, so that a sharp object before a soft ground is sharp.
    """
    tile = max(1, max(grey.shape) // 16)
    tiles = (max(1, grey.shape[1] // tile), max(1, grey.shape[0] // tile))
    mean = lambda a: cv2.resize(a, tiles, interpolation=cv2.INTER_AREA).ravel()
    fine = mean(_gradient(grey))
    coarse = mean(_gradient(cv2.GaussianBlur(grey, (0, 0), 2.0)))

    textured = np.argsort(coarse)[-max(1, len(coarse) // 4) :]
    ratio = np.log2((fine[textured] + 1e-7) / (coarse[textured] + 1e-7))
    return float(np.percentile(ratio, 75))


def motion(a: np.ndarray, b: np.ndarray) -> float:
    """How far content moved between two small grey pictures, in pixels, where it moved most (90th
    percentile over tiles): difference over gradient, which holds up to about a pixel.
    """
    tiles = (min(TILES, a.shape[1]), min(TILES, a.shape[0]))
    mean = lambda x: cv2.resize(x, tiles, interpolation=cv2.INTER_AREA).ravel()
    difference = mean((a - b)[:-1, :-1] ** 2)
    gradient = mean(0.5 * (_gradient(a) + _gradient(b)))

    textured = gradient > 0.1 * gradient.mean()
    if not textured.any():
        return 0.0
    return float(np.percentile(np.sqrt(difference[textured] / gradient[textured]), 90))


def doubles(looks: list[Look]) -> dict[int, int]:
    """Photo -> the photo of its group that stays, for all that are doubles."""
    sharpest_first = sorted(range(len(looks)), key=lambda k: (-looks[k].energy, k))
    tiny = np.stack([look.tiny.ravel() for look in looks])
    alike = tiny @ tiny.T
    kept: list[int] = []
    out = {}
    for k in sharpest_first:
        same = (
            j
            for j in kept
            if alike[j, k] > ALIKE
            and looks[j].small.shape == looks[k].small.shape
            and motion(looks[j].small, looks[k].small) < STILL
        )
        twin = next(same, None)
        if twin is None:
            kept.append(k)
        else:
            out[k] = twin
    return out


def blurred(looks: list[Look]) -> list[int]:
    """Photos, the worst first, that are less sharp than those around them in the list by both
    measures; at most the share MOST.
    """
    if len(looks) < FEWEST:
        return []

    lost = np.stack([_below_neighbours(looks, name) for name in ("energy", "detail")])
    found = np.flatnonzero((lost.sum(0) > LOSS) & (lost.min(0) > LEAST_LOSS))
    worst_first = found[np.argsort(-lost[:, found].sum(0))]
    return worst_first[: int(MOST * len(looks))].tolist()


def _below_neighbours(looks: list[Look], measure: str) -> np.ndarray:
    """By how much each photo's measure lies below the median of its neighbours'."""
    values = np.array([getattr(look, measure) for look in looks])
    out = np.empty(len(values))
    for k in range(len(values)):
        around = np.arange(max(0, k - NEIGHBOURS), min(len(values), k + NEIGHBOURS + 1))
        out[k] = np.median(values[around[around != k]]) - values[k]
    return out


def choose(looks: list[Look], may_go: list[bool]) -> list[Reason | None]:
    """Why each photo, in the order in which they were taken, is left out; None for those that stay.

    may_go: False for photos that stay whatever they look like.
    """
    out: list[Reason | None] = [None] * len(looks)
    candidates = [k for k, free in enumerate(may_go) if free]
    if not candidates:
        return out

    twins = doubles([looks[k] for k in candidates])
    for k, twin in twins.items():
        out[candidates[k]] = (DOUBLED, candidates[twin])

    single = [k for k in candidates if out[k] is None]
    for k in blurred([looks[k] for k in single]):
        out[single[k]] = (BLURRED, None)
    return out
