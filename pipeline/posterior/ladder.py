"""Gloss and metal rung by rung: a body keeps what photos that were left out ask for, and no more.

The surface begins as one dielectric of one number and climbs. Rungs, simplest first:

    matt              roughness 1, no metal
    one gloss         the surface's median roughness everywhere, no metal
    gloss of a body   the body's own median roughness, no metal
    gloss map         the roughness map, no metal
    one metal         metal all over the body, of its median roughness
    as drawn          both maps

Some photos are left out of the base colours (left_out.py). On every rung all bodies stand at once,
with base colours of their own from the other photos, solved from the same ones, and are judged by
blocks of pixels of the photos left out, by the error e of a score (render/metrics.py: squared, as
sRGB values):

    gain = sum over blocks b of g_b,    g_b = sum over pixels of b of e_simple - e_rich

The gain's standard error is sqrt(B) times the standard deviation of the g_b over B blocks. The
surface as a whole climbs to a rung whose gain over the one it stands on would be chance CHANCE of
the time, which is two standard errors where blocks are many; of the first two, which are one number
each, it begins on the one that predicts better. Then every body leaves the surface's rung, up or
down, only for one that gains as clearly on its own pixels, the number of rungs that it tries
allowed for: materials grow from one.

Where the surface's rung does not clearly beat matt, all that is no metal is tried without any
highlight, too, and goes without if that predicts better: none is simpler than any. A dielectric of
roughness 1 still mirrors 4 % of the light, widely. What real glossy things mirror is in small
places instead, and where normals are in error no lobe finds them: on a plastic toy no highlight is
better than a wide one (docs/results.md).

A body is what has one colour after the shading is divided out (split_gibbs/regions.py), so that the
border of a material follows the stuff and not the light. e is the product of two pictures' errors
from independent paths: the square of one would hold the path tracer's noise, which differs between
materials.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from pipeline.posterior.base_color import USUAL
from pipeline.posterior.color_choices import METAL, color_map, solver_for
from pipeline.posterior.left_out import Fold, gain, residuals, squared_error, surely
from pipeline.posterior.map_pixels import MapPixels
from pipeline.posterior.problem import Problem, renderer_seed
from pipeline.posterior.shading import Shading
from pipeline.posterior.split_gibbs.regions import group, texel_regions
from pipeline.posterior.textures import gather
from pipeline.render.renderer import LAMBERTIAN, NO_HIGHLIGHT, Explanation

CHANCE = 0.023  # of a step that is none: two standard errors of a normal
EQUALLY_SIMPLE = 2  # rungs, the first ones
BARE = "no highlight"
GROUPED = 20_000  # pixels whose colours are grouped into bodies
SAME_COLOR = 0.95  # share of the colours' spread that bodies explain: one too many does no harm

# an explanation that a base colour can be solved from, and what its light and gloss give to the
# observed pixels of a problem, which are places on its maps too, from paths through so many of them
Shade = Callable[
    [Problem, MapPixels, Explanation, int, np.random.Generator], tuple[Explanation, Shading]
]


@dataclass(frozen=True)
class Rung:
    """A name, and what roughness and metallic (t, t) are on it."""

    name: str
    roughness: np.ndarray
    metallic: np.ndarray

    @property
    def metal(self) -> bool:
        """Whether any of it is."""
        return bool((self.metallic > 0).any())

    def put_on(self, x: Explanation) -> Explanation:
        return replace(x, roughness=self.roughness, metallic=self.metallic)


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
    return unlike(found)


def unlike(found: list[Rung]) -> list[Rung]:
    """The first two rungs, and those above that are not the same as a simpler one: a single body's
    gloss is the surface's.
    """
    same = lambda a, b: (a.roughness == b.roughness).all() and (a.metallic == b.metallic).all()
    new = lambda k: not any(same(found[k], lower) for lower in found[:k])
    return [rung for k, rung in enumerate(found) if k < EQUALLY_SIMPLE or new(k)]


def climbed(errors: list[np.ndarray], block: np.ndarray) -> tuple[int, list[dict]]:
    """The rung that the surface stands on in the end, and every step that was tried: `from` and
    `to` (numbers of rungs), `gain` and its `standard_error` as shares of the error. errors: squared
    errors (n,) of its pixels on every rung.
    """
    stands, tried = 0, []
    clear = surely(CHANCE, block)
    for higher in range(1, len(errors)):
        step = tried_step(errors, block, stands, higher)
        tried.append(step)
        needed = 0 if higher < EQUALLY_SIMPLE else clear * step["standard_error"]
        if step["gain"] > needed:
            stands = higher
    return stands, tried


def of_a_body(errors: list[np.ndarray], block: np.ndarray, stands: int) -> tuple[int, list[dict]]:
    """As `climbed`, for a body that begins on the surface's rung `stands`. It leaves by CHANCE as
    often as if it tried one other rung only.
    """
    tried = []
    others = [k for k in range(len(errors)) if k != stands]
    clear = surely(CHANCE / len(others), block)
    for other in others:
        step = tried_step(errors, block, stands, other)
        tried.append(step)
        if step["gain"] > clear * step["standard_error"]:
            stands = other
    return stands, tried


def tried_step(errors: list[np.ndarray], block: np.ndarray, at: int, to: int) -> dict:
    """What `climbed` says of one step."""
    share, error = gain(errors[at], errors[to], block)
    return {"from": at, "to": to, "gain": share, "standard_error": error}


class Jury:
    """Judges explanations by photos that their base colours are not made from, in every fold."""

    def __init__(self, problem: Problem, parts: list[Fold], shade: Shade, pixels: int, seed: int):
        """pixels: that paths go through for the base colours of one fold; seed: of all paths, the
        same for all explanations, so that most of their noise is the same, too.
        """
        self.problem, self.parts, self.shade, self.seed = problem, parts, shade, seed
        # most pixels make the colours of several folds: what light gives to them is traced once
        together = np.unique(np.concatenate([fold.kept for fold in parts]))
        self.kept = problem.with_pixels(together)
        self.of_fold = [np.searchsorted(together, fold.kept) for fold in parts]
        side = problem.renderer.texture
        self.on_map = MapPixels(self.kept.observations, side)
        self.fold_on_map = [
            MapPixels(self.kept.observations.with_pixels(index), side) for index in self.of_fold
        ]
        self.pixels = round(pixels * len(together) / len(parts[0].kept))

    @property
    def block(self) -> np.ndarray:
        """Blocks (n,) of the judged pixels of all folds."""
        return np.concatenate([fold.block for fold in self.parts])

    @property
    def judged(self) -> np.ndarray:
        """Their numbers (n,) among the problem's pixels."""
        return np.concatenate([fold.judged for fold in self.parts])

    def solved(self, x: Explanation) -> Iterator[Explanation]:
        """`x` with the base colours of every fold, from its other photos."""
        rng = np.random.default_rng(self.seed)
        begin, shading = self.shade(self.kept, self.on_map, x, self.pixels, rng)
        return (self.colored(begin, shading, fold) for fold in range(len(self.parts)))

    def residuals(self, x: Explanation) -> np.ndarray:
        """`left_out.residuals` (2, n, 3) of the judged pixels of all folds, each `solved`."""
        of_folds = [
            residuals(self.problem, y, fold.judged, self.seed)
            for fold, y in zip(self.parts, self.solved(x))
        ]
        return np.concatenate(of_folds, 1)

    def errors(self, x: Explanation) -> np.ndarray:
        """Squared errors (n,) of these pixels."""
        return squared_error(self.residuals(x))

    def colored(self, begin: Explanation, shading: Shading, fold: int) -> Explanation:
        """`begin` with the base colour that the kept pixels of a fold show under a shading of all
        folds'.
        """
        of_some = shading.of(self.of_fold[fold])
        solver = solver_for(self.fold_on_map[fold], of_some, begin.base_color)
        return replace(begin, base_color=color_map(solver, USUAL)[0])


def climb(
    problem: Problem,
    x: Explanation,
    parts: list[Fold],
    shade: Shade,
    pixels: int,
    rng: np.random.Generator,
) -> tuple[Explanation, np.ndarray, dict]:
    """The explanation with every body on its rung; which texels (t, t) keep the roughness map; and
    the evidence. The base colour is that of the lowest rung and has to be solved anew. pixels: that
    paths go through for the base colours of a rung.
    """
    uv = problem.observations.uv[parts[0].kept]
    matt = rungs(x, np.zeros(x.roughness.shape, int), uv)[0].put_on(x)
    jury = Jury(problem, parts, shade, pixels, renderer_seed(rng))
    matt = next(jury.solved(matt))  # light between parts of the surface is of their colours
    body = bodies(matt.base_color, uv, rng)
    found = rungs(x, body, uv)
    errors = [jury.errors(rung.put_on(matt)) for rung in found]

    block = jury.block
    at_judged = gather(body.astype(np.float32), problem.observations.uv[jury.judged])[:, 0]
    of_pixel = at_judged.round().astype(int)
    surface, of_surface = climbed(errors, block)
    rung_of, of_bodies = climbed_by_bodies(errors, block, of_pixel, int(body.max()) + 1, surface)
    evidence = {
        "photos_left_out": sum(fold.photos for fold in parts),
        "folds": len(parts),
        "blocks": len(np.unique(block)),
        "judged_pixels": len(jury.judged),
        "rungs": [rung.name for rung in found],
        "surface": {"chosen": found[surface].name, "tried": of_surface},
        "bodies": [
            {"share": float((of_pixel == b).mean()), "chosen": found[k].name, "tried": tried}
            for b, (k, tried) in enumerate(zip(rung_of, of_bodies))
        ],
    }

    at_texel = lambda values: np.array(values)[rung_of][body]
    chosen = put_together(matt, found, at_texel(range(len(found))))
    keeps_map = at_texel([rung.name in ("gloss map", "as drawn") for rung in found])
    if clearly_gains(errors[0], errors[surface], block):
        return chosen, keeps_map, evidence

    of_chosen = np.array(errors)[np.array(rung_of)[of_pixel], np.arange(len(of_pixel))]
    is_metal = at_texel([rung.metal for rung in found])
    bare = without_highlight(chosen, is_metal)
    share, error = gain(of_chosen, jury.errors(bare), block)
    goes = share > 0  # none is simpler than one, and need not gain clearly
    evidence[BARE] = {"chosen": bool(goes), "gain": share, "standard_error": error}
    return (bare, keeps_map & is_metal, evidence) if goes else (chosen, keeps_map, evidence)


def climbed_by_bodies(
    errors: list[np.ndarray], block: np.ndarray, of_pixel: np.ndarray, bodies: int, surface: int
) -> tuple[list[int], list[list[dict]]]:
    """As `of_a_body`, for each of so many: the rung it stands on and the steps that were tried.
    of_pixel (n,): the body of every judged pixel.
    """
    mine = [of_pixel == b for b in range(bodies)]
    found = [of_a_body([e[some] for e in errors], block[some], surface) for some in mine]
    return [stands for stands, _ in found], [tried for _, tried in found]


def put_together(x: Explanation, found: list[Rung], at_texel: np.ndarray) -> Explanation:
    """The explanation with every texel's roughness and metallic of the rung `at_texel` (t, t)."""
    of_rung = lambda name: np.choose(at_texel, [getattr(rung, name) for rung in found])
    return replace(x, roughness=of_rung("roughness"), metallic=of_rung("metallic"))


def clearly_gains(simple: np.ndarray, rich: np.ndarray, block: np.ndarray) -> bool:
    """Whether the second's squared errors (n,) are clearly smaller than the first's."""
    share, error = gain(simple, rich, block)
    return share > surely(CHANCE, block) * error


def without_highlight(x: Explanation, is_metal: np.ndarray) -> Explanation:
    """The explanation with all that is no metal diffuse, nearly Lambert's. is_metal (t, t)."""
    roughness = np.where(is_metal, x.roughness, LAMBERTIAN).astype(np.float32)
    return replace(x, roughness=roughness, ior=NO_HIGHLIGHT)
