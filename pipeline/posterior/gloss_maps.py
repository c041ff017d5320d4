"""Roughness and metallic as numbers, where photos ask for no map.

Blocks of pixels are held out of the base colour and of the gloss. Candidates go from the simplest
to the maps as they are, each with a base colour of its own from the pixels that are left, and each
is judged on those blocks. Residuals r (relative errors of problem.py) have heavy tails: edges and
highlights in the wrong place would drown a normal distribution's sum. With Student's t of FREEDOM
degrees of freedom and scale s,

    gain = sum over blocks b of g_b,    g_b = sum over pixels of b of l(r_simple) - l(r_map),
    l(r) = (FREEDOM + 1) / 2 log(1 + r^2 / (FREEDOM s^2))

is the gain of the maps in log likelihood, in nats; s^2 is the maps' median r^2. Residuals of
neighbouring pixels go together, so the blocks count as independent, not the pixels: the gain's
standard error is sqrt(B) times the standard deviation of the g_b over B blocks. The first candidate
over which the maps gain no more than CLEAR standard errors is taken.

r^2 is the product of two pictures' residuals from independent paths: the square of one would hold
the path tracer's noise, which differs between materials.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from pipeline.posterior.problem import PixelBatch, Problem, renderer_seed
from pipeline.posterior.textures import gather
from pipeline.render.observe import Observations
from pipeline.render.renderer import Explanation

BLOCKS = 24  # along the long side of a photo
FINEST = 4  # pixels along a side of a block, at least
HELD_OUT = 0.2  # share of the blocks
FEWEST = 10  # held-out blocks, below which a standard error over them says nothing
JUDGED = 8000  # pixels of those blocks at most
PATHS = 8  # through each, for either of two pictures
CLEAR = 2.0  # standard errors
FREEDOM = 3.0
LEAST_SCALE = 1e-6  # s^2: photos are never explained to less than 8 bits

# an explanation, with the base colour that the observations of a problem show under its gloss
SolveColor = Callable[[Problem, Explanation], Explanation]


@dataclass
class Split:
    """Observed pixels by their numbers: `kept` (k,) make the maps, `judged` (n,) judge them, and
    `block` (n,) says of which block each of these is.
    """

    kept: np.ndarray
    judged: np.ndarray
    block: np.ndarray


def split(observations: Observations, rng: np.random.Generator) -> Split | None:
    """HELD_OUT of the blocks that show something, at random; JUDGED of their pixels judge. None
    where those blocks are fewer than FEWEST.
    """
    views = observations.views
    long_side = max(max(view.width, view.height) for view in views)
    side = max(FINEST, -(-long_side // BLOCKS))
    column, row = observations.pixel.T.astype(int) // side
    name = (observations.view * (row.max() + 1) + row) * (column.max() + 1) + column
    number = np.unique(name, return_inverse=True)[1]

    count = int(number.max()) + 1
    if round(HELD_OUT * count) < FEWEST:
        return None
    out = np.zeros(count, bool)
    out[rng.choice(count, round(HELD_OUT * count), replace=False)] = True
    held = np.flatnonzero(out[number])
    judged = np.sort(rng.choice(held, min(JUDGED, len(held)), replace=False))
    return Split(np.flatnonzero(~out[number]), judged, number[judged])


def with_pixels(problem: Problem, index: np.ndarray) -> Problem:
    """The problem with the observed pixels `index` only; the renderer is shared."""
    some = copy.copy(problem.observations)
    for name in ("view", "pixel", "rgb", "clipped", "uv", "cosine"):
        setattr(some, name, getattr(some, name)[index])
    return Problem(some, problem.renderer, problem.roughness_min, problem.normal_error)


def squared_residual(
    problem: Problem, explanation: Explanation, index: np.ndarray, seed: int
) -> np.ndarray:
    """Mean over the channels of the squared relative error, without the paths' noise, of the pixels
    `index`: (n,). The same seed takes the same rays and paths.
    """
    observations = problem.observations
    rng = np.random.default_rng(seed)
    problem.renderer.set(explanation)
    pictures = [
        np.mean(
            [
                problem.renderer.radiance(*observations.rays(index, rng), renderer_seed(rng))
                for _ in range(PATHS)
            ],
            axis=0,
        )
        for _ in range(2)
    ]

    nothing = np.empty((0, len(index), 3))
    photo, clipped = observations.rgb[index], observations.clipped[index]
    batch = PixelBatch(index, nothing, nothing, photo, clipped)
    one, two = (Problem.residual(picture, batch) for picture in pictures)
    return (one * two).mean(1)


def surprise(squared: np.ndarray, scale: float) -> np.ndarray:
    """l(r) in nats, but for a constant, of squared residuals (n,), for s^2 = `scale`."""
    return 0.5 * (FREEDOM + 1) * np.log1p(np.maximum(squared, 0) / (FREEDOM * scale))


def gain(simple: np.ndarray, rich: np.ndarray, block: np.ndarray) -> tuple[float, float]:
    """Gain of `rich` over `simple` in log likelihood (nats), and its standard error, from squared
    residuals (n,) of pixels in blocks (n,).
    """
    scale = max(float(np.median(rich)), LEAST_SCALE)
    number = np.unique(block, return_inverse=True)[1]
    of_block = np.bincount(number, surprise(simple, scale) - surprise(rich, scale))
    spread = of_block.std(ddof=1) if len(of_block) > 1 else np.inf
    return float(of_block.sum()), float(np.sqrt(len(of_block)) * spread)


def flat(image: np.ndarray, value: float) -> np.ndarray:
    return np.full(image.shape, value, np.float32)


def candidates(x: Explanation, uv: np.ndarray) -> dict[str, list[tuple[str, np.ndarray]]]:
    """For metallic and roughness what may stand in for the map, simplest first, with a name: none
    at all (metallic), and the median over the pixels at uv (n, 2).
    """
    median = {n: float(np.median(gather(getattr(x, n), uv))) for n in ("metallic", "roughness")}
    found: dict[str, list[tuple[str, np.ndarray]]] = {
        "metallic": [("none", flat(x.metallic, 0.0))],
        "roughness": [("one value", flat(x.roughness, median["roughness"]))],
    }
    if median["metallic"] > 0.01:
        found["metallic"].append(("one value", flat(x.metallic, median["metallic"])))
    return found


def simplest_gloss(
    problem: Problem,
    explanation: Explanation,
    parts: Split,
    solve: SolveColor,
    rng: np.random.Generator,
) -> tuple[Explanation, dict]:
    """The explanation with roughness and metallic as simple as the `judged` blocks allow, with its
    base colour solved anew, and for either what was chosen and the evidence: gain of the map over
    each candidate, and its standard error, in nats.

    Metallic goes first. A candidate for roughness is compared with the roughness map beside the
    metallic that was chosen, and beside the one that was there: what the first choice gained must
    not pay for the second, and what both lose must not add up unseen; the evidence is the clearer
    of the two. The explanation's gloss must not come from `judged` pixels.
    """
    kept = with_pixels(problem, parts.kept)
    seed = renderer_seed(rng)
    judge = lambda x: squared_residual(problem, x, parts.judged, seed)
    best = solve(kept, explanation)
    richer = [judge(best)]

    facts: dict = {"blocks": len(np.unique(parts.block)), "judged_pixels": len(parts.judged)}
    possible = candidates(explanation, kept.observations.uv)
    for name, simpler in possible.items():
        facts[name] = {"chosen": "map", "gain_of_the_map": {}}
        for title, image in simpler:
            tried = solve(kept, replace(best, **{name: image}))
            left = judge(tried)
            gains = [gain(left, rich, parts.block) for rich in richer]
            nats, error = max(gains, key=lambda found: found[0] - CLEAR * found[1])
            facts[name]["gain_of_the_map"][title] = {"nats": nats, "standard_error": error}
            if nats <= CLEAR * error:
                best = tried
                richer.append(left)
                facts[name] |= {"chosen": title, "value": float(image.flat[0])}
                break
    return best, facts
