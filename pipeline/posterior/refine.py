"""Materials at full texture size with the light's shape held, and one light scale (DPI, Eq. 17).

Four steps, one after the other:

1. Light scale: a closed-form factor.
2. Base colour in closed form (base_color.py), from few paths (shading.py).
3. Roughness and metallic: Adam through the path tracer, on maps of moderate size, because photos
   say little about their fine detail. The base colour moves along. Where the sampler drew them,
   roughness stays near the draw and metallic as drawn.
4. Base colour again, with these and at full size.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pipeline.base.config import Refine
from pipeline.base.progress import Bar
from pipeline.posterior.base_color import USUAL, Sharpness, color_map, shared_between_photos
from pipeline.posterior.material_optimizer import MaterialOptimizer
from pipeline.posterior.problem import ALBEDO_MAX, SHADE, Problem, renderer_seed
from pipeline.posterior.shading import shade
from pipeline.posterior.textures import fill, gather, seen_texels
from pipeline.render.renderer import Explanation, resize_explanation

COARSE = 256  # side of the maps while roughness and metallic are moved
SCALE_RANGE = (0.5, 2.0)  # within which the light's scale is refined
SCALE_PIXELS = 8  # pixels for the light's scale, as a multiple of a step's
DARKEST_START = 0.02  # base colour: a black one has no direction to move in
# factor by which roughness may move from a draw: the width of what one draw believes of a region
ROUGHNESS_FACTOR = 1.3
FEWER = 5  # part of the final solve's pixels that do for the first one, on coarse maps
COLOR_UNITS = 25  # progress: a base colour solve takes as long as so many of Adam's steps


def units(settings: Refine) -> int:
    """How far `refine` moves its progress bar."""
    return settings.steps + 2 * COLOR_UNITS


def solve_base_color(
    problem: Problem,
    explanation: Explanation,
    pixels: int,
    rng: np.random.Generator,
    sharpness: Sharpness | None = None,
) -> tuple[Explanation, dict]:
    """The explanation with the base colour that the photos show under its light and gloss, from
    paths through `pixels` pixels. `sharpness` and the facts are those of `color_map`.
    """
    begin = np.clip(explanation.base_color, DARKEST_START, ALBEDO_MAX).astype(np.float32)
    explanation = replace(explanation, base_color=begin)
    shading = shade(problem, explanation, pixels, rng)
    metallic = gather(explanation.metallic, problem.observations.uv)
    shading = shared_between_photos(problem.observations, shading, metallic, len(begin))

    color, facts = color_map(problem.observations, shading, begin, sharpness)
    return replace(explanation, base_color=color), facts


def light_scale(
    problem: Problem, explanation: Explanation, pixels: int, rng: np.random.Generator
) -> float:
    """Least-squares factor of the light, sum w L y / sum w L L over random unsaturated pixels,
    within SCALE_RANGE.
    """
    observations = problem.observations
    index = rng.integers(len(observations), size=pixels)
    unsaturated = ~observations.clipped[index]
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
    explained = (weight * 0.5 * (one + two) * photo).sum()
    factor = float(explained / np.maximum((weight * one * two).sum(), 1e-9))
    return float(np.clip(factor, *SCALE_RANGE))


def stay_near(materials: MaterialOptimizer, drawn: Explanation) -> None:
    """Bound roughness of `materials` to what lies near the draw's, and metallic to what is drawn:
    a surface is of one kind or another, and a draw says of which.
    """
    low, high = materials.bounds["roughness"]
    materials.bounds["roughness"] = (
        np.maximum(drawn.roughness / ROUGHNESS_FACTOR, low),
        np.minimum(drawn.roughness * ROUGHNESS_FACTOR, high),
    )
    materials.bounds["metallic"] = drawn.metallic, drawn.metallic


def move_gloss(
    problem: Problem,
    explanation: Explanation,
    settings: Refine,
    near: bool,
    bar: Bar,
    rng: np.random.Generator,
) -> Explanation:
    """All three maps after `settings.steps` steps of Adam through the path tracer, light held;
    near: roughness stays near what it is, and metallic as it is.
    """
    materials = MaterialOptimizer(explanation, settings.learning_rate, problem.roughness_min)
    if near:
        stay_near(materials, explanation)

    losses = []
    for step in range(settings.steps):
        materials.set_learning_rate(settings.learning_rate * 0.1 ** (step / settings.steps))
        now = materials.explanation(explanation.light)
        batch = problem.batch(settings.pixels, settings.spp, rng)
        gradient = problem.gradient(now, batch, renderer_seed(rng))
        materials.step(gradient)
        losses.append(gradient.loss)
        bar.step(f"loss {np.mean(losses[-20:]):.4f}")
    return materials.explanation(explanation.light)


def refine(
    problem: Problem,
    small: Problem,
    sample: Explanation,
    settings: Refine,
    seed: int,
    bar: Bar,
    drawn: bool = False,
) -> tuple[Explanation, dict]:
    """A posterior sample's maps at `settings.texture`, and facts.

    Eq. 17 (published): k, s = argmin over k, s of sum_i || y_i - R(s x, k, c_i) ||^2

    for the materials k and one scale s of the light, from the sample's k, with the sample's light x
    held; 200 steps of Adam.

    Ours: the relative error of problem.py. s is found once, in closed form and within SCALE_RANGE,
    before k. Adam moves k on maps of side COARSE at most; the full-size base colour is a robust
    mean over the photos (`base_color.color_map`), and texels that no photo shows take the nearest
    seen one's values.

    problem: renders at full texture size; small: at min(COARSE, full). drawn: the sampler drew the
    light's scale and metallic, which then stay, and roughness, which stays near (`stay_near`).
    `bar` moves on by `units(settings)`.
    """
    rng = np.random.default_rng([977, seed])
    coarse = resize_explanation(sample, small.renderer.texture)
    scale = 1.0
    if not drawn:
        scale = light_scale(small, coarse, SCALE_PIXELS * settings.pixels, rng)
    coarse = replace(coarse, light=(sample.light * scale).astype(np.float32))

    coarse, first = solve_base_color(small, coarse, settings.shading_pixels // FEWER, rng, USUAL)
    bar.step("base colour", COLOR_UNITS)
    coarse = move_gloss(small, coarse, settings, drawn, bar, rng)

    full = resize_explanation(coarse, settings.texture)
    full, last = solve_base_color(problem, full, settings.shading_pixels, rng)
    bar.step("base colour", COLOR_UNITS)

    seen = seen_texels(problem.observations.uv, settings.texture)
    full = replace(full, roughness=fill(full.roughness, seen), metallic=fill(full.metallic, seen))
    return full, {
        "light_scale": scale,
        "loss_before": first["loss"],
        "loss_last_update": last["loss"],
        "texel_surroundings": last["around"],
        "sharpening_passes": last["passes"],
        "seen_share_of_texels": float(seen.mean()),
    }
