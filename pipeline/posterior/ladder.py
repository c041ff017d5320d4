"""Gloss and metal rung by rung: a body keeps what photos that were left out ask for, and no more.

The surface begins as one dielectric of one number and climbs. Rungs, simplest first:

    matt              roughness 1, no metal
    one gloss         the surface's median roughness everywhere, no metal
    gloss of a body   the body's own median roughness, no metal
    gloss map         the roughness map, no metal
    one metal         metal all over the body, of its median roughness
    as drawn          both maps

Some photos are left out of the base colours. On every rung all bodies stand at once, with base
colours of their own from the other photos, and are judged by blocks of pixels of the photos left
out, by the error e of a score (render/metrics.py: squared, as sRGB values):

    gain = sum over blocks b of g_b,    g_b = sum over pixels of b of e_simple - e_rich

Errors of neighbouring pixels go together, so blocks count as independent, not pixels: the gain's
standard error is sqrt(B) times the standard deviation of the g_b over B blocks. The surface as a
whole climbs to a rung that gains more than CLEAR standard errors over the one it stands on; of the
first two, which are one number each, it begins on the one that predicts better. Then every body
leaves the surface's rung, up or down, only for one that gains as clearly on its own pixels:
materials grow from one.

Whole photos are left out, not blocks of pixels alone: a base colour that a photo's own pixels make
holds its highlights as paint, and would hide what a metal explains.

A body is what has one colour after the shading is divided out (split_gibbs/regions.py), so that the
border of a material follows the stuff and not the light. e is the product of two pictures' errors
from independent paths: the square of one would hold the path tracer's noise, which differs between
materials.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from pipeline.posterior.problem import Problem, renderer_seed
from pipeline.posterior.split_gibbs.regions import group, texel_regions
from pipeline.posterior.textures import gather
from pipeline.render.metrics import crossed_error
from pipeline.render.observe import Observations
from pipeline.render.renderer import Explanation

LEFT_OUT = 0.2  # share of the photos
MOST_LEFT_OUT = 8  # photos
BLOCKS = 24  # along the long side of a photo
FINEST = 4  # pixels along a side of a block, at least
FEWEST = 10  # blocks, below which a standard error over them says nothing
FEWEST_PHOTOS = 4
SOLVED = 200_000  # pixels of the other photos, at most, that a rung's base colour is made from
JUDGED = 8_000  # pixels of the blocks at most
PATHS = 16  # through each, for either of two pictures
CLEAR = 2.0  # standard errors
LEAST = 1e-9  # error of all pixels together
EQUALLY_SIMPLE = 2  # rungs, the first ones
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


def squared_error(
    problem: Problem, explanation: Explanation, index: np.ndarray, seed: int
) -> np.ndarray:
    """Squared error of sRGB values, mean over the channels and without the paths' noise, of the
    pixels `index`: (n,). The same seed takes the same rays and paths.
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
    return crossed_error(pictures[0], observations.rgb[index], pictures[1]).mean(1)


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
        """Of the `chosen` pixels' roughness, by body; of all of them where a body has none."""
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


def climbed(errors: list[np.ndarray], block: np.ndarray) -> tuple[int, list[dict]]:
    """The rung that the surface stands on in the end, and every step that was tried: `from` and
    `to` (numbers of rungs), `gain` and its `standard_error` as shares of the error. errors: squared
    errors (n,) of its pixels on every rung.
    """
    stands, tried = 0, []
    for higher in range(1, len(errors)):
        step = tried_step(errors, block, stands, higher)
        tried.append(step)
        clear = 0 if higher < EQUALLY_SIMPLE else CLEAR * step["standard_error"]
        if step["gain"] > clear:
            stands = higher
    return stands, tried


def of_a_body(errors: list[np.ndarray], block: np.ndarray, stands: int) -> tuple[int, list[dict]]:
    """As `climbed`, for a body that begins on the surface's rung `stands`."""
    tried = []
    for other in [k for k in range(len(errors)) if k != stands]:
        step = tried_step(errors, block, stands, other)
        tried.append(step)
        if step["gain"] > CLEAR * step["standard_error"]:
            stands = other
    return stands, tried


def tried_step(errors: list[np.ndarray], block: np.ndarray, at: int, to: int) -> dict:
    """What `climbed` says of one step."""
    share, error = gain(errors[at], errors[to], block)
    return {"from": at, "to": to, "gain": share, "standard_error": error}


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

    errors = [squared_error(problem, matt, parts.judged, seed)]
    for rung in found[1:]:
        solved = solve(kept, rung.put_on(matt))
        errors.append(squared_error(problem, solved, parts.judged, seed))

    at_judged = gather(body.astype(np.float32), problem.observations.uv[parts.judged])[:, 0]
    roughness, metallic = np.empty_like(x.roughness), np.empty_like(x.metallic)
    keeps_map = np.zeros(body.shape, bool)
    facts = []
    surface, of_surface = climbed(errors, parts.block)
    for b in range(int(body.max()) + 1):
        mine = at_judged.round() == b
        stands, tried = of_a_body([e[mine] for e in errors], parts.block[mine], surface)
        rung, here = found[stands], body == b
        roughness[here], metallic[here] = rung.roughness[here], rung.metallic[here]
        keeps_map[here] = rung.name in ("gloss map", "as drawn")
        facts.append({"share": float(mine.mean()), "chosen": rung.name, "tried": tried})

    chosen = replace(matt, roughness=roughness, metallic=metallic)
    return (
        chosen,
        keeps_map,
        {
            "photos_left_out": parts.photos,
            "blocks": len(np.unique(parts.block)),
            "judged_pixels": len(parts.judged),
            "rungs": [rung.name for rung in found],
            "surface": {"chosen": found[surface].name, "tried": of_surface},
            "bodies": facts,
        },
    )
