"""Views of known lights that no measured map is like, so that a network sees more than a hundred
places: two maps in one, latitude stretched, much contrast.

A hundred maps are learnt by heart within half a million views of `augment.draw_view`. What these
views show is no place, but made of parts of places; the network is told that they were made, as it
is of procedural maps, so that what it draws as measured stays a place.
"""

from __future__ import annotations

import numpy as np

from pipeline.prior.training.augment import coloured, moved, random_mirror
from pipeline.prior.value_code import FLOOR
from pipeline.render.envmap import directions, resample_area

STILL = 0.3  # share of the maps that are turned only
MOVE_ALONG, MOVE_UP = 0.55, 0.2  # largest moves of the others, in radii
STRETCH = 0.5, 0.25  # most of latitude's two stretches (`augment.moved`)
ACROSS, UPPER = 0.35, 0.35  # shares of the views that are two maps, side by side or one above
BORDER = 0.02, 0.3  # softness between them, radians, random in its log
HALF_WIDTH = 0.25, 0.75  # of the first map's part, side by side, in half turns
LEVEL = 0.12  # deviation of the border's latitude, one above the other, radians
WHITE_BALANCE, CONTRAST = 0.2, 0.25  # deviations of log gain per channel and of log gamma


def draw_strong_view(
    one: np.ndarray, other: np.ndarray, height: int, rng: np.random.Generator
) -> tuple[np.ndarray, bool]:
    """A view (height, 2 height, 3) of scale-free radiance `one` and perhaps `other`, both (H, 2H,
    3) with H >= height, and whether it shows both.
    """
    share = part_of_other(len(one), rng)
    if share is None:
        mixed = placed(one, rng)
    else:  # in log radiance, as codes are: no lamp is seen through a wall
        log = lambda env: np.log(np.maximum(placed(env, rng), FLOOR / 3))
        mixed = np.exp((1 - share) * log(one) + share * log(other))
    view = coloured(resample_area(mixed, height, 2 * height), WHITE_BALANCE, CONTRAST, rng)
    return view, share is not None


def placed(env: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Turned, mirrored, seen from a moved point, and its latitudes stretched."""
    angle, radius = rng.uniform(0, 2 * np.pi), MOVE_ALONG * np.sqrt(rng.random())
    up = rng.uniform(-MOVE_UP, MOVE_UP)
    origin = np.array([radius * np.cos(angle), up, radius * np.sin(angle)])
    origin = origin * (rng.random() >= STILL)
    stretch = [rng.uniform(-most, most) for most in STRETCH]
    return random_mirror(moved(env, origin, rng.uniform(0, 2 * np.pi), stretch), rng)


def part_of_other(h: int, rng: np.random.Generator) -> np.ndarray | None:
    """Where the other map is shown, in [0, 1], as (h, 2h, 1); None: nowhere."""
    kind, soft = rng.random(), np.exp(rng.uniform(*np.log(BORDER)))
    if kind >= ACROSS + UPPER:
        return None
    d = directions(h, 2 * h)
    if kind < ACROSS:
        centre, half = rng.uniform(0, 2 * np.pi), np.pi * rng.uniform(*HALF_WIDTH)
        inside = np.cos(np.arctan2(d[..., 0], d[..., 2]) - centre) - np.cos(half)
    else:
        inside = np.arcsin(np.clip(d[..., 1], -1, 1)) - LEVEL * rng.normal()
    return (0.5 + 0.5 * np.tanh(inside / (2 * soft)))[..., None]
