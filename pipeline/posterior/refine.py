"""Materials at full texture size with the light's shape held, and one light scale (DPI, Eq. 17).

Three blocks, one after the other:

1. Light scale: a closed-form factor.
2. Roughness and metallic: Adam through the path tracer, on maps of moderate size, because photos
   say little about their fine detail. The base colour moves along.
3. Base colour at full size. The picture is nearly linear in it: L = a D + S, with a the base
   colour, D the shading and S what does not scale with the base colour. So per texel
   a = mean (y - S) / mean D over the pixels y that see the texel.

S is every pixel's own, for highlights move with the view: averaged over views they would stay in
the texture. Shading is smooth where colour is not: D is blurred over a few texels, which takes the
path tracer's noise out and leaves the photos' detail in.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from pipeline.base.config import Refine
from pipeline.base.progress import Bar
from pipeline.posterior.material_optimizer import MaterialOptimizer
from pipeline.posterior.problem import ALBEDO_MAX, SHADE, Problem, renderer_seed
from pipeline.posterior.textures import fill, gather, splat
from pipeline.render.renderer import Explanation, resize_explanation

COARSE = 256  # side of the maps while roughness and metallic are moved
SHADING_BLUR = 3.0  # texels at 1024 over which shading is averaged
SOLVES = 6  # back-projections per base colour update
CONTRADICTION = 0.25  # relative residual at which a pixel loses half its weight
SCALE_RANGE = (0.5, 2.0)  # within which the light's scale is refined
SCALE_PIXELS = 8  # pixels for the light's scale, as a multiple of a step's
DARKEST_START = 0.02  # base colour: a black one has no direction to move in
CHUNK = 1 << 18  # pixels rendered at once


@dataclass
class ShadingModel:
    """The photos as linear in the base colour: `target` = base colour x `shading`, per texel.

    shading (t, t, 3): D, blurred. seen (t, t): texels that photos see. target (n, 3): y - S of
    every pixel. loss: mean squared relative error of the picture that it was made from.
    """

    shading: np.ndarray
    seen: np.ndarray
    target: np.ndarray
    loss: float


def split_picture(
    problem: Problem,
    explanation: Explanation,
    index: np.ndarray,
    spp: int,
    rng: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray]:
    """Picture L (n, 3) of the pixels `index`, and its part a D (n, 3) that scales with the base
    colour.

    a D is twice the difference to the picture with half the base colour, with the same rays and
    random numbers.
    """
    half = replace(explanation, base_color=0.5 * explanation.base_color)
    rays = [problem.observations.rays(index, rng) for _ in range(spp)]
    seeds = [renderer_seed(rng) for _ in range(spp)]

    pictures = []
    for maps in (explanation, half):
        problem.renderer.set(maps)
        paths = [
            problem.renderer.radiance(origins, directions, seed)
            for (origins, directions), seed in zip(rays, seeds)
        ]
        pictures.append(np.mean(paths, axis=0))

    whole, with_half = pictures
    return whole, 2 * (whole - with_half)


def view_weight(cosine: np.ndarray) -> np.ndarray:
    """Weight (n, 1) of pixels by their cosine of incidence (n,): grazing views smear, for their
    pixels cover many texels.
    """
    return cosine[:, None] ** 2


def shading_model(
    problem: Problem, explanation: Explanation, spp: int, rng: np.random.Generator
) -> ShadingModel:
    """The model at `explanation`, from `spp` paths through every pixel.

    y is the photo's value; where that is saturated, the larger of it and the prediction.
    """
    observations = problem.observations
    size = explanation.base_color.shape[0]
    sums = np.zeros((size, size, 4))  # of D in three channels, and of the weights
    target = []
    loss = 0.0

    for k in range(0, len(observations), CHUNK):
        index = np.arange(k, min(k + CHUNK, len(observations)))
        picture, scaled = split_picture(problem, explanation, index, spp, rng)
        uv = observations.uv[index]
        photo = observations.rgb[index]
        clipped = observations.clipped[index][:, None]
        photo = np.where(clipped, np.maximum(photo, picture), photo)

        shading = scaled / gather(explanation.base_color, uv)
        counted = np.concatenate([shading, np.ones((len(index), 1))], 1)
        sums += splat(uv, view_weight(observations.cosine[index]) * counted, size)
        target.append(photo - (picture - scaled))
        loss += float((((photo - picture) / (photo + SHADE)) ** 2).sum())

    return ShadingModel(
        smooth_shading(sums),
        sums[..., 3] > 0.05,
        np.concatenate(target),
        loss / (3 * len(observations)),
    )


def smooth_shading(sums: np.ndarray) -> np.ndarray:
    """Blurred mean D (t, t, 3) from sums (t, t, 4) of weighted D and of the weights."""
    width = max(SHADING_BLUR * sums.shape[0] / 1024, 0.6)
    blurred = lambda total: cv2.GaussianBlur(total, (0, 0), width, borderType=cv2.BORDER_REPLICATE)
    mean = blurred(sums[..., :3]) / np.maximum(blurred(sums[..., 3])[..., None], 1e-6)
    return np.maximum(mean, 1e-3)


def solve_base_color(
    problem: Problem, explanation: Explanation, spp: int, rng: np.random.Generator
) -> tuple[Explanation, float]:
    """Least squares over all pixels for the whole base colour map; also the mean squared relative
    error before it.

    With D and S held, y - S = bilinear(a D) is solved by back-projecting the residual, with weights
    that forget pixels which other views contradict (Geman-McClure): occlusion edges, slightly wrong
    cameras, highlights in the wrong place.
    """
    observations = problem.observations
    size = explanation.base_color.shape[0]
    begin = np.clip(explanation.base_color, DARKEST_START, ALBEDO_MAX).astype(np.float32)
    explanation = replace(explanation, base_color=begin)
    model = shading_model(problem, explanation, spp, rng)

    weight = view_weight(observations.cosine)
    color = begin.astype(np.float64)
    for k in range(SOLVES):
        predicted = gather((color * model.shading).astype(np.float32), observations.uv)
        residual = model.target - predicted
        relative = np.abs(residual / (observations.rgb + SHADE)).mean(-1, keepdims=True)
        # the first solve trusts all pixels: its residuals are those of the old base colour
        trust = weight / (1 + (relative / CONTRADICTION) ** 2) if k else weight

        total = np.maximum(splat(observations.uv, trust, size), 1e-6)
        step = splat(observations.uv, trust * residual, size) / total
        moved = np.clip(color + step / model.shading, 0.0, ALBEDO_MAX)
        color = np.where(model.seen[..., None], moved, color)

    color = fill(color, model.seen).astype(np.float32)
    return replace(explanation, base_color=color), model.loss


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


def move_gloss(
    problem: Problem,
    explanation: Explanation,
    settings: Refine,
    title: str,
    rng: np.random.Generator,
) -> Explanation:
    """All three maps after `settings.steps` steps of Adam through the path tracer, light held."""
    materials = MaterialOptimizer(explanation, settings.learning_rate, problem.roughness_min)
    losses = []

    with Bar(title, max(settings.steps, 1)) as bar:
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
    rescale: bool = True,
) -> tuple[Explanation, dict]:
    """A posterior sample's maps at `settings.texture`, and facts.

    Eq. 17 (published): k, s = argmin over k, s of sum_i || y_i - R(s x, k, c_i) ||^2

    for the materials k and one scale s of the light, from the sample's k, with the sample's light x
    held; 200 steps of Adam.

    Ours: the relative error of problem.py. s is found once, in closed form and within SCALE_RANGE,
    before k. Adam moves k on maps of side COARSE at most; the full-size base colour is solved for
    by robust least squares (`solve_base_color`), and texels that no photo shows take the nearest
    seen one's values.

    problem: renders at full texture size; small: at min(COARSE, full). rescale: whether s is
    refined; not where the sampler drew it.
    """
    rng = np.random.default_rng([977, seed])
    coarse = resize_explanation(sample, small.renderer.texture)
    scale = light_scale(small, coarse, SCALE_PIXELS * settings.pixels, rng) if rescale else 1.0
    coarse = replace(coarse, light=(sample.light * scale).astype(np.float32))

    coarse, loss_before = solve_base_color(small, coarse, 4, rng)
    coarse = move_gloss(small, coarse, settings, f"refine {seed}", rng)

    full = resize_explanation(coarse, settings.texture)
    for spp in (4, 8):
        full, loss_last = solve_base_color(problem, full, spp, rng)

    seen = seen_texels(problem, settings.texture)
    full = replace(full, roughness=fill(full.roughness, seen), metallic=fill(full.metallic, seen))
    return full, {
        "light_scale": scale,
        "loss_before": loss_before,
        "loss_last_update": loss_last,
        "seen_share_of_texels": float(seen.mean()),
    }


def seen_texels(problem: Problem, size: int) -> np.ndarray:
    """Texels (size, size) next to an observed pixel's texture coordinates."""
    uv = problem.observations.uv
    return splat(uv, np.ones((len(uv), 1)), size)[..., 0] > 1e-3
