"""Photos that are left out of a base colour, and judge what it was made under.

One set of them where photos are many, else several sets in turn, so that most of few photos judge:
cross-validation (Stone 1974). Whole photos are left out, not blocks of pixels alone: a base colour
that a photo's own pixels make holds its highlights as paint, and would hide what a metal explains.

Errors of neighbouring pixels go together, so blocks of pixels count as independent, not pixels.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import stdtrit

from pipeline.base.images import linear_to_srgb
from pipeline.posterior.problem import Problem
from pipeline.render.observe import Observations
from pipeline.render.renderer import Explanation

LEFT_OUT = 0.2  # share of the photos, in one fold
MOST_LEFT_OUT = 8  # photos: as many judge in one fold, or in several
BLOCKS = 24  # along the long side of a photo
FINEST = 4  # pixels along a side of a block, at least
FEWEST = 10  # blocks, below which a standard error over them says nothing
FEWEST_PHOTOS = 4
SOLVED = 200_000  # pixels of the other photos, about, that a rung's base colour is made from
JUDGED = 8_000  # pixels of the blocks at most, of all folds together
PATHS = 16  # through each, for either of two pictures
LEAST = 1e-9  # error of all pixels together


@dataclass(frozen=True)
class Fold:
    """Observed pixels by their numbers: `kept` (k,) make the base colours, `judged` (n,) judge, and
    `block` (n,) says of which block each of these is; photos: how many are left out.
    """

    kept: np.ndarray
    judged: np.ndarray
    block: np.ndarray
    photos: int


def folds(observations: Observations, rng: np.random.Generator) -> list[Fold]:
    """Each leaves out LEFT_OUT of the photos, at random and no photo twice: as many as it takes
    until MOST_LEFT_OUT photos judge, or all do. None where there are fewer than FEWEST_PHOTOS, or
    all blocks are fewer than FEWEST.
    """
    photos, block = np.unique(observations.view), block_of(observations)
    if len(photos) < FEWEST_PHOTOS or block.max() + 1 < FEWEST:
        return []
    count = min(max(1, round(LEFT_OUT * len(photos))), MOST_LEFT_OUT)
    turns = min(-(-MOST_LEFT_OUT // count), len(photos) // count)
    sets = np.split(rng.permutation(photos)[: turns * count], turns)
    # so many of all photos' pixels that each fold has SOLVED, most of them in every fold
    most = round(SOLVED * len(photos) / (len(photos) - count))
    enough = np.sort(rng.permutation(len(observations))[:most])
    return [split(observations, block, out, enough, JUDGED // len(sets), rng) for out in sets]


def block_of(observations: Observations) -> np.ndarray:
    """Of which block of which photo every observed pixel is (n,), numbered from 0."""
    long_side = max(max(view.width, view.height) for view in observations.views)
    side = max(FINEST, -(-long_side // BLOCKS))
    column, row = observations.pixel.T.astype(int) // side
    name = (observations.view * (row.max() + 1) + row) * (column.max() + 1) + column
    return (np.cumsum(np.bincount(name) > 0) - 1)[name]


def split(
    observations: Observations,
    block: np.ndarray,
    out: np.ndarray,
    enough: np.ndarray,
    judged: int,
    rng: np.random.Generator,
) -> Fold:
    """`judged` pixels of the photos `out`, or as many as there are, and those of `enough` that the
    others show; block (n,): of all pixels (`block_of`).
    """
    is_out = np.isin(observations.view, out)
    judging = np.flatnonzero(is_out)
    judging = np.sort(rng.choice(judging, min(judged, len(judging)), replace=False))
    kept = enough[~is_out[enough]]
    return Fold(kept, judging, block[judging], len(out))


def residuals(
    problem: Problem, explanation: Explanation, index: np.ndarray, seed: int
) -> np.ndarray:
    """What the pixels `index` of two independent pictures have more than the photos, as sRGB
    values: (2, n, 3). The same seed takes the same rays and paths.
    """
    observations = problem.observations
    problem.renderer.set(explanation)
    rays = lambda rng: observations.rays(index, rng)
    pictures = [problem.renderer.mean_radiance(rays, PATHS, seed + k) for k in range(2)]
    return linear_to_srgb(np.stack(pictures)) - linear_to_srgb(observations.rgb[index])


def squared_error(of_pictures: np.ndarray) -> np.ndarray:
    """Squared error, mean over the channels and without the paths' noise, of every pixel: (n,),
    from `residuals`. Both pictures' errors are multiplied (render/metrics.py).
    """
    return (of_pictures[0] * of_pictures[1]).mean(1)


def gain(simple: np.ndarray, rich: np.ndarray, block: np.ndarray) -> tuple[float, float]:
    """By what share of its error `simple` is worse than `rich`, and the standard error of that
    share, from squared errors (n,) of pixels in blocks (n,). Fewer than FEWEST blocks say nothing:
    0, 0.
    """
    blocks, number = np.unique(block, return_inverse=True)
    if len(blocks) < FEWEST:
        return 0.0, 0.0
    of_block = np.bincount(number, simple - rich)
    whole = max(float(simple.sum()), LEAST)
    spread = float(of_block.std(ddof=1))
    return float(of_block.sum()) / whole, float(np.sqrt(len(blocks))) * spread / whole


def surely(chance: float, block: np.ndarray) -> float:
    """How many standard errors over blocks a gain exceeds by `chance`: Student's t."""
    return float(stdtrit(max(len(np.unique(block)) - 1, 1), 1 - chance))
