"""Gloss and metal rung by rung: a body keeps what photos that were left out ask for, and no more.

Every body of the surface begins as a matt dielectric and climbs. Rungs, simplest first:

    matt              roughness 1, no metal
    one gloss         the surface's median roughness everywhere, no metal
    gloss of a body   the body's own median roughness, no metal
    gloss map         the roughness map, no metal
    one metal         metal all over the body, of its median roughness
    as drawn          both maps

Some photos are left out of the base colours. On every rung all bodies stand at once, with base
colours of their own from the other photos, and are judged by blocks of pixels of the photos left
out. Residuals r (relative errors of problem.py) have heavy tails: edges and highlights in the wrong
place would drown a normal distribution's sum. With Student's t of FREEDOM degrees of freedom and
scale s,

    gain = sum over blocks b of g_b,    g_b = sum over pixels of b of l(r_simple) - l(r_rich),
    l(r) = (FREEDOM + 1) / 2 log(1 + r^2 / (FREEDOM s^2))

is the gain of the richer rung in log likelihood, in nats; s^2 is its median r^2. Residuals of
neighbouring pixels go together, so blocks count as independent, not pixels: the gain's standard
error is sqrt(B) times the standard deviation of the g_b over B blocks. A body climbs to a rung that
gains more than CLEAR standard errors over the one it stands on.

Whole photos are left out, not blocks of pixels alone: a base colour that a photo's own pixels make
holds its highlights as paint, and would hide what a metal explains.

A body is what has one colour after the shading is divided out (split_gibbs/regions.py), so that the
border of a material follows the stuff and not the light. r^2 is the product of two pictures'
residuals from independent paths: the square of one would hold the path tracer's noise, which
differs between materials.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from pipeline.posterior.problem import PixelBatch, Problem, renderer_seed
from pipeline.posterior.split_gibbs.regions import group, texel_regions
from pipeline.posterior.textures import gather
from pipeline.render.observe import Observations
from pipeline.render.renderer import Explanation

LEFT_OUT = 0.2  # share of the photos
MOST_LEFT_OUT = 8  # photos
BLOCKS = 24  # along the long side of a photo
FINEST = 4  # pixels along a side of a block, at least
FEWEST = 10  # blocks, below which a standard error over them says nothing: a body stays matt
FEWEST_PHOTOS = 4
SOLVED = 200_000  # pixels of the other photos, at most, that a rung's base colour is made from
JUDGED = 16_000  # pixels of the blocks at most
PATHS = 6  # through each, for either of two pictures
CLEAR = 2.0  # standard errors
FREEDOM = 3.0
LEAST_SCALE = 1e-6  # s^2: photos are never explained to less than 8 bits
GROUPED = 20_000  # pixels whose colours are grouped into bodies
SAME_COLOR = 0.95  # share of the colours' spread that bodies explain: one too many does no harm
METAL = 0.5  # metallic from which on a texel is of metal

# an explanation, with the base colour that the observations of a problem show under its gloss
SolveColor = Callable[[Problem, Explanation], Explanation]


@dataclass(frozen=True)
class Split:
    """Observed pixels by their numbers: `kept` (k,) make the base colours, `judged` (n,) judge, and
    `block` (n,) says of which block each of these is; photos: how many are left out.
    """

    kept: np.ndarray
    judged: np.ndarray
    block: np.ndarray
    photos: int


@dataclass(frozen=True)
class Rung:
    """A name, and what roughness and metallic (t, t) are on it."""

    name: str
    roughness: np.ndarray
    metallic: np.ndarray

    def put_on(self, x: Explanation) -> Explanation:
        return replace(x, roughness=self.roughness, metallic=self.metallic)


def split(observations: Observations, rng: np.random.Generator) -> Split | None:
    """LEFT_OUT of the photos, at random. None where there are fewer than FEWEST_PHOTOS, or they
    have fewer than FEWEST blocks.
    """
    photos = np.unique(observations.view)
    if len(photos) < FEWEST_PHOTOS:
        return None
    count = min(max(1, round(LEFT_OUT * len(photos))), MOST_LEFT_OUT)
    asked = rng.choice(photos, count, replace=False)
    out = np.isin(observations.view, asked)

    long_side = max(max(view.width, view.height) for view in observations.views)
    side = max(FINEST, -(-long_side // BLOCKS))
    column, row = observations.pixel.T.astype(int) // side
    name = (observations.view * (row.max() + 1) + row) * (column.max() + 1) + column
    number = np.unique(name, return_inverse=True)[1]
    if len(np.unique(number[out])) < FEWEST:
        return None

    some = lambda pixels, most: np.sort(rng.choice(pixels, min(most, len(pixels)), replace=False))
    judged = some(np.flatnonzero(out), JUDGED)
    kept = some(np.flatnonzero(~out), SOLVED)
    return Split(kept, judged, number[judged], count)


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
    residuals (n,) of pixels in blocks (n,). Fewer than FEWEST blocks say nothing: 0, 0.
    """
    number = np.unique(block, return_inverse=True)[1]
    if len(np.unique(block)) < FEWEST:
        return 0.0, 0.0
    scale = max(float(np.median(rich)), LEAST_SCALE)
    of_block = np.bincount(number, surprise(simple, scale) - surprise(rich, scale))
    return float(of_block.sum()), float(np.sqrt(len(of_block)) * of_block.std(ddof=1))


def bodies(color: np.ndarray, uv: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Body of every texel (t, t), numbered from 0, by a map of base colour (t, t, 3); uv (n, 2): of
    pixels that show the surface.
    """
    some = rng.choice(len(uv), min(GROUPED, len(uv)), replace=False)
    seed = int(rng.integers(2**31))
    _, centres = group(gather(color, uv[some]), SAME_COLOR, seed)
    return texel_regions(color, centres, color.shape[0])


def rungs(x: Explanation, body: np.ndarray, uv: np.ndarray) -> list[Rung]:
    """The rungs below `x`, simplest first, and `x` itself. body (t, t); uv (n, 2): of pixels that
    show the surface, whose medians are taken.
    """
    at = lambda image: gather(image, uv)[:, 0]
    roughness, metallic = at(x.roughness), at(x.metallic) > METAL
    of_pixel = at(body.astype(np.float32)).round().astype(int)
    flat = lambda value: np.full(x.roughness.shape, value, np.float32)
    none = flat(0)

    def medians(chosen: np.ndarray) -> np.ndarray:
        """Of the roughness of the `chosen` pixels, by body; of all of them where a body has none."""
        whole = np.median(roughness[chosen] if chosen.any() else roughness)
        of_body = [roughness[chosen & (of_pixel == b)] for b in range(int(body.max()) + 1)]
        return np.array([np.median(v) if len(v) else whole for v in of_body], np.float32)

    dielectric = ~metallic if (~metallic).any() else np.ones_like(metallic)
    found = [
        Rung("matt", flat(1), none),
        Rung("one gloss", flat(np.median(roughness[dielectric])), none),
        Rung("gloss of a body", medians(dielectric)[body], none),
        Rung("gloss map", x.roughness, none),
    ]
    if metallic.any():
        found.append(Rung("one metal", medians(metallic)[body], flat(1)))
        found.append(Rung("as drawn", x.roughness, x.metallic))
    return found


def climbed(left: list[np.ndarray], block: np.ndarray) -> tuple[int, list[dict]]:
    """The rung that a body stands on in the end, and every step that was tried: `from` and `to`
    (numbers of rungs), `nats`, `standard_error`. left: squared residuals (n,) of its pixels on
    every rung.
    """
    stands, tried = 0, []
    for higher in range(1, len(left)):
        nats, error = gain(left[stands], left[higher], block)
        tried.append({"from": stands, "to": higher, "nats": nats, "standard_error": error})
        if nats > CLEAR * error:
            stands = higher
    return stands, tried


def climb(
    problem: Problem,
    x: Explanation,
    parts: Split,
    solve: SolveColor,
    rng: np.random.Generator,
) -> tuple[Explanation, np.ndarray, dict]:
    """The explanation with every body on its rung; which texels (t, t) keep the roughness map; and
    the evidence. The base colour is that of the lowest rung and has to be solved anew.
    """
    kept = with_pixels(problem, parts.kept)
    seed = renderer_seed(rng)
    uv = kept.observations.uv
    matt = solve(kept, rungs(x, np.zeros(x.roughness.shape, int), uv)[0].put_on(x))
    body = bodies(matt.base_color, uv, rng)
    found = rungs(x, body, uv)

    left = [squared_residual(problem, matt, parts.judged, seed)]
    for rung in found[1:]:
        tried = solve(kept, rung.put_on(matt))
        left.append(squared_residual(problem, tried, parts.judged, seed))

    at_judged = gather(body.astype(np.float32), problem.observations.uv[parts.judged])[:, 0]
    roughness, metallic = np.empty_like(x.roughness), np.empty_like(x.metallic)
    keeps_map = np.zeros(body.shape, bool)
    facts = []
    for b in range(int(body.max()) + 1):
        mine = at_judged.round() == b
        stands, tried = climbed([r[mine] for r in left], parts.block[mine])
        rung, here = found[stands], body == b
        roughness[here], metallic[here] = rung.roughness[here], rung.metallic[here]
        keeps_map[here] = rung.name in ("gloss map", "as drawn")
        facts.append({"share": float(mine.mean()), "chosen": rung.name, "tried": tried})

    chosen = replace(matt, roughness=roughness, metallic=metallic)
    return chosen, keeps_map, {
        "photos_left_out": parts.photos,
        "blocks": len(np.unique(parts.block)),
        "judged_pixels": len(parts.judged),
        "rungs": [rung.name for rung in found],
        "bodies": facts,
    }
