"""Materials at full texture size with the light's shape held, and one light scale (DPI, Eq. 17).

Four steps, one after the other:

1. Light scale: a closed-form factor, where the sampler did not draw it.
2. Base colour in closed form (base_color.py), from few paths (shading.py); and a brighter light, if
   colours above 1 would be needed under this one.
3. Roughness, which from here on holds what the mesh's normals miss too (`as_the_mesh_shows`), and
   metallic. With `gloss: tested` every body of the surface begins matt and keeps as much of the
   draw's gloss and metal as photos that were left out ask for (ladder.py). What the sampler drew
   stays as drawn. A roughness that it did not draw and that stays a map is moved with the other
   maps: Adam through the path tracer, on maps of moderate size, because photos say little about
   their fine detail.
4. Base colour again, with these and at full size, and with the light in details that are finer than
   few paths show (missed_light.py). Maps of moderate size hide colours above 1, and what was drawn
   as metal may be matt now: the light may have to be brighter still.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pipeline.base.config import Refine
from pipeline.base.progress import Bar
from pipeline.geometry.mesh_io import Mesh, load_mesh
from pipeline.posterior.base_color import USUAL, Sharpness, shared_between_photos
from pipeline.posterior.color_choices import brighter_light, color_map, solver_for
from pipeline.posterior.ladder import climb
from pipeline.posterior.left_out import folds
from pipeline.posterior.map_pixels import MapPixels
from pipeline.posterior.missed_light import with_missed_light
from pipeline.posterior.problem import ALBEDO_MAX, SHADE, Problem, renderer_seed
from pipeline.posterior.shading import Shading, shade
from pipeline.posterior.textures import seen_texels
from pipeline.posterior.unseen_colors import over_unseen
from pipeline.render.principled_lobes import blurred_roughness
from pipeline.render.renderer import Explanation, resize_explanation
from pipeline.surface.normal_error import per_axis

COARSE = 256  # side of the maps while roughness and metallic are moved
SCALE_RANGE = (0.5, 2.0)  # within which the light's scale is refined
DARK = 1e-6  # factor by which a light is as good as out
SCALE_PIXELS = 8  # pixels for the light's scale, as a multiple of a step's
DARKEST_START = 0.02  # base colour: a black one has no direction to move in
FEWER = 5  # part of the final solve's traced pixels that do for the first one, on coarse maps
FEWEST = 10  # the same for the rungs of the ladder
COARSE_PIXELS = 500_000  # observed pixels, at most, that coarse maps are made from: seven a texel
COLOR_UNITS = 25  # progress: a base colour solve takes as long as so many of Adam's steps


def units(settings: Refine) -> int:
    """How far `refine` moves its progress bar."""
    return settings.steps + 2 * COLOR_UNITS


def shading_by_color(
    problem: Problem,
    on_map: MapPixels,
    explanation: Explanation,
    pixels: int,
    rng: np.random.Generator,
) -> tuple[Explanation, Shading]:
    """The explanation with base colours that a solve can begin from, and what its light and gloss
    give to every pixel, from paths through `pixels` pixels. on_map: the problem's pixels on maps of
    the base colour's size.
    """
    begin = np.clip(explanation.base_color, DARKEST_START, ALBEDO_MAX).astype(np.float32)
    explanation = replace(explanation, base_color=begin)
    shading = shade(problem, explanation, pixels, rng)
    return explanation, shared_between_photos(on_map, shading)


def solve_base_color(
    problem: Problem,
    explanation: Explanation,
    pixels: int,
    rng: np.random.Generator,
    sharpness: Sharpness | None = None,
    texel_paths: float = 0,
    brighter: bool = False,
) -> tuple[Explanation, dict]:
    """The explanation with the base colour that the photos show under its light and gloss, from
    paths through `pixels` pixels and `texel_paths` more for every texel (`with_missed_light`).

    brighter: the light becomes as bright as base colours <= 1 need it (`brighter_light`), but where
    the ground is known, and so the light's scale. `sharpness` and the facts are those of
    `color_map`, and `brighter`, the light's factor.
    """
    on_map = MapPixels(problem.observations, len(explanation.base_color))
    begin, shading = shading_by_color(problem, on_map, explanation, pixels, rng)
    if texel_paths:
        shading = with_missed_light(problem, on_map, begin, shading, texel_paths, rng)
    solver, factor = solver_for(on_map, shading, begin.base_color), 1.0
    if brighter and problem.renderer.ground is None:
        factor = brighter_light(solver)
    color, facts = color_map(solver.under(factor), sharpness)
    light = (factor * begin.light).astype(np.float32)
    return replace(begin, base_color=color, light=light), facts | {"brighter": factor}


def light_scale(
    problem: Problem, explanation: Explanation, pixels: int, rng: np.random.Generator
) -> float:
    """Least-squares factor of the light, sum w L y / sum w L L over random unsaturated pixels,
    within SCALE_RANGE. What the ground gives is known, and taken off L and y.
    """
    observations = problem.observations
    index = rng.integers(len(observations), size=pixels)
    unsaturated = ~observations.clipped[index].any(1)
    if unsaturated.any():
        index = index[unsaturated]

    # two independent pictures: the square of one would hold the path tracer's noise
    problem.renderer.set(explanation)
    one, two = (
        problem.renderer.radiance(*observations.rays(index, rng), renderer_seed(rng))
        for _ in range(2)
    )
    photo = observations.rgb[index]
    weight = 1 / (photo + SHADE) ** 2
    if problem.renderer.ground is not None:
        problem.renderer.set(replace(explanation, light=DARK * explanation.light))
        from_ground = [
            problem.renderer.radiance(*observations.rays(index, rng), renderer_seed(rng))
            for _ in range(2)
        ]
        one, two = one - from_ground[0], two - from_ground[1]
        photo = photo - 0.5 * (from_ground[0] + from_ground[1])
    explained = (weight * 0.5 * (one + two) * photo).sum()
    factor = float(explained / np.maximum((weight * one * two).sum(), 1e-9))
    return float(np.clip(factor, *SCALE_RANGE))


def as_the_mesh_shows(sample: Explanation, normal_error: float) -> Explanation:
    """A drawn explanation with the roughness of lobes over normals in error: the sampler draws the
    material's own, and normals beside it, which no asset has.

    normal_error: median, radians. Of the mesh alone, the material's sharp highlight lies where it
    does not in the photos, and where it would not under another light.
    """
    spread = np.array(per_axis(normal_error))
    roughness = blurred_roughness(sample.roughness, spread)
    return replace(sample, roughness=roughness.astype(np.float32))


def some_pixels(problem: Problem, rng: np.random.Generator) -> np.ndarray:
    """Numbers of COARSE_PIXELS random observed pixels, in order; of all where there are fewer."""
    count = len(problem.observations)
    return np.sort(rng.choice(count, min(COARSE_PIXELS, count), replace=False))


def judged_gloss(
    problem: Problem, explanation: Explanation, settings: Refine, rng: np.random.Generator
) -> tuple[Explanation, np.ndarray, dict]:
    """With `settings.gloss` "tested" the explanation with as much gloss and metal as photos ask for
    (`climb`), which texels (t, t) keep a map of roughness, and what was chosen, as the fact
    `gloss`; the explanation as it is, all of it as maps, where too few photos can judge.
    """
    everywhere = np.ones(explanation.roughness.shape, bool)
    if settings.gloss == "maps":
        return explanation, everywhere, {}
    parts = folds(problem.observations, rng)
    if not parts:
        why = "too few photos to judge them by"
        return explanation, everywhere, {"gloss": {"why": why}}

    few = settings.shading_pixels // FEWEST
    found, maps, facts = climb(problem, explanation, parts, shading_by_color, few, rng)
    if maps.any():  # they have colours of their own, not those of a matt surface
        some = problem.with_pixels(some_pixels(problem, rng))
        found = solve_base_color(some, found, few, rng, USUAL)[0]
    return found, maps, {"gloss": facts}


def smooth_where_unseen(
    explanation: Explanation, seen: np.ndarray, seen_gloss: np.ndarray, mesh: Mesh
) -> Explanation:
    """The explanation with maps that join on smoothly where no photo shows the surface. seen,
    seen_gloss: which texels of the base colour and of the other maps photos show. Where all that is
    seen is a metal or none, so is the rest: by what more of its surroundings are.
    """
    gloss = np.stack([explanation.roughness, explanation.metallic], -1)
    roughness, metallic = np.moveaxis(over_unseen(gloss, seen_gloss, mesh), -1, 0)
    if np.isin(explanation.metallic[seen_gloss], (0, 1)).all():
        metallic = np.rint(metallic)
    color = over_unseen(explanation.base_color, seen, mesh)
    return replace(explanation, base_color=color, roughness=roughness, metallic=metallic)


def refine(
    problem: Problem,
    sample: Explanation,
    settings: Refine,
    seed: int,
    bar: Bar,
    drawn: bool = False,
) -> tuple[Explanation, dict]:
    """A posterior sample's maps at `settings.texture` (`gloss_texture`), and facts.

    Eq. 17 (published): k, s = argmin over k, s of sum_i || y_i - R(s x, k, c_i) ||^2

    for the materials k and one scale s of the light, from the sample's k, with the sample's light x
    held; 200 steps of Adam.

    Ours: the relative error of problem.py. s is found once, in closed form and within SCALE_RANGE,
    before k, and is raised where base colours under 1 cannot explain the photos (`brighter_light`).
    Adam moves k, but for a draw's gloss, on maps of side COARSE at most; the full-size base colour
    is a robust mean over the photos (`color_map`), and what no photo shows joins on to it smoothly
    (`over_unseen`).

    problem: renders with maps of side `settings.texture`. drawn: the sampler drew the light's
    scale, which is then only ever raised, roughness and metallic, which Adam then leaves alone.
    `bar` moves on by `units(settings)`.
    """
    rng = np.random.default_rng([977, seed])
    small = problem.at_texture(min(COARSE, settings.texture))
    coarse = resize_explanation(sample, small.renderer.texture)
    scale = 1.0
    if drawn:
        coarse = as_the_mesh_shows(coarse, problem.normal_error)
    else:
        scale = light_scale(small, coarse, SCALE_PIXELS * settings.pixels, rng)
    coarse = replace(coarse, light=(sample.light * scale).astype(np.float32))

    some = small.with_pixels(some_pixels(small, rng))
    few = settings.shading_pixels // FEWER
    coarse, first = solve_base_color(some, coarse, few, rng, USUAL, brighter=True)
    bar.step("base colour", COLOR_UNITS)
    coarse, moves, tested = judged_gloss(small, coarse, settings, rng)
    if drawn or not moves.any():
        bar.step("gloss", settings.steps)
    else:
        # loads torch, which takes as long as a base colour: refinements of draws do without
        from pipeline.posterior.move_gloss import move_gloss

        coarse = move_gloss(small, coarse, settings, moves, bar, rng)

    gloss = settings.gloss_texture or settings.texture
    full = resize_explanation(coarse, settings.texture, gloss)
    full, last = solve_base_color(
        problem, full, settings.shading_pixels, rng, None, settings.texel_paths, brighter=True
    )
    bar.step("base colour", COLOR_UNITS)

    seen = seen_texels(problem.observations.uv, settings.texture)
    seen_gloss = seen if gloss == settings.texture else seen_texels(problem.observations.uv, gloss)
    return smooth_where_unseen(full, seen, seen_gloss, load_mesh(problem.renderer.mesh)), {
        "light_scale": scale * first["brighter"] * last["brighter"],
        "roughness_of_normals": float(per_axis(problem.normal_error)) if drawn else 0.0,
        "loss_before": first["loss"],
        "loss_last_update": last["loss"],
        "texel_surroundings": last["around"],
        "sharpening_passes": last["passes"],
        "seen_share_of_texels": float(seen.mean()),
        **tested,
    }
