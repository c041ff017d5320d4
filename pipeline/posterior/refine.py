"""Materials at full texture size with the light's shape held, and one light scale (DPI, Eq. 17).

Three blocks in turn. Roughness and metallic: Adam through the path tracer, on maps of moderate
size, because photos say little about their fine detail. Light scale: a closed-form factor. Base
colour at full size: the picture is nearly linear in it, L = a D + S with D the shading and S what
does not scale with the base colour, so per texel a = mean (y - S) / mean D over the pixels that see
the texel. S is every pixel's own, for highlights move with the view: averaged over views they would
stay in the texture. Shading is smooth where colour is not: D is blurred over a few texels, which
takes the path tracer's noise out and leaves the photos' detail in.
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from pipeline.base.config import Refine
from pipeline.base.progress import Bar
from pipeline.posterior.problem import ALBEDO_MAX, SHADE, Materials, Problem, step_seed
from pipeline.posterior.textures import fill, gather, splat
from pipeline.render.renderer import Explanation, resize_explanation

COARSE = 256  # side of the roughness and metallic maps during the steps
SHADING_BLUR = 3.0  # texels at 1024 over which shading is averaged
SOLVES = 6  # back-projections per base colour update
CONTRADICTION = 0.25  # relative residual at which a pixel loses half its weight


def shading(
    problem: Problem, x: Explanation, index: np.ndarray, spp: int, rng
) -> tuple[np.ndarray, np.ndarray]:
    """Picture L (n, 3) of the pixels `index`, and its part a D (n, 3) that scales with the base
    colour.

    a D is twice the difference to the picture with half the base colour, with the same rays and
    random numbers.
    """
    half = replace(x, base_color=0.5 * x.base_color)
    rays = [problem.observations.rays(index, rng) for _ in range(spp)]
    seeds = [step_seed(rng) for _ in range(spp)]
    pictures = []
    for maps in (x, half):
        problem.renderer.set(maps)
        pictures.append(
            np.mean([problem.renderer.radiance(o, d, s) for (o, d), s in zip(rays, seeds)], axis=0)
        )
    return pictures[0], 2 * (pictures[0] - pictures[1])


def shading_maps(problem: Problem, x: Explanation, spp: int, rng, chunk: int = 1 << 18):
    """D (t, t, 3) of `x` averaged per texel and blurred, texels seen (t, t), y - S of every pixel
    (n, 3), and the loss.

    y is the photo's value; where that is saturated, the larger of it and the prediction.
    """
    obs, size = problem.observations, x.base_color.shape[0]
    sums, diffuse, loss = np.zeros((size, size, 4)), [], 0.0
    for k in range(0, len(obs), chunk):
        index = np.arange(k, min(k + chunk, len(obs)))
        L, scaled = shading(problem, x, index, spp, rng)
        y = np.where(obs.clipped[index][:, None], np.maximum(obs.rgb[index], L), obs.rgb[index])
        seen = np.concatenate(
            [scaled / gather(x.base_color, obs.uv[index]), np.ones((len(index), 1))], 1
        )
        sums += splat(obs.uv[index], view_weight(obs.cosine[index]) * seen, size)
        diffuse.append(y - (L - scaled))
        loss += float((((y - L) / (y + SHADE)) ** 2).sum())
    blur = lambda total: cv2.GaussianBlur(
        total, (0, 0), max(SHADING_BLUR * size / 1024, 0.6), borderType=cv2.BORDER_REPLICATE
    )
    D = blur(sums[..., :3]) / np.maximum(blur(sums[..., 3])[..., None], 1e-6)
    return np.maximum(D, 1e-3), sums[..., 3] > 0.05, np.concatenate(diffuse), loss / (3 * len(obs))


def view_weight(cosine: np.ndarray) -> np.ndarray:
    """Grazing views smear: their pixels cover many texels. (n, 1)"""
    return cosine[:, None] ** 2


def base_color_block(problem: Problem, x: Explanation, spp: int, rng) -> tuple[Explanation, float]:
    """Least squares over all pixels for the whole base colour map; also the mean squared weighted
    residual before it.

    With D and S held, y - S = bilinear(a D) is solved by back-projecting the residual, with weights
    that forget pixels which other views contradict (Geman-McClure): occlusion edges, slightly wrong
    cameras, highlights in the wrong place.
    """
    obs, size = problem.observations, x.base_color.shape[0]
    x = replace(
        x, base_color=np.clip(x.base_color, 0.02, ALBEDO_MAX).astype(np.float32)
    )  # black has no direction to move
    D, known, diffuse, loss = shading_maps(problem, x, spp, rng)
    weight, color = view_weight(obs.cosine), x.base_color.astype(np.float64)
    for k in range(SOLVES):
        r = diffuse - gather((color * D).astype(np.float32), obs.uv)
        relative = np.abs(r / (obs.rgb + SHADE)).mean(-1, keepdims=True)
        trust = weight / (1 + (relative / CONTRADICTION) ** 2) if k else weight
        step = splat(obs.uv, trust * r, size) / np.maximum(splat(obs.uv, trust, size), 1e-6)
        color = np.where(known[..., None], np.clip(color + step / D, 0.0, ALBEDO_MAX), color)
    return replace(x, base_color=fill(color, known).astype(np.float32)), loss


def light_scale(problem: Problem, x: Explanation, pixels: int, rng) -> float:
    """Least-squares factor of the light: sum w L y / sum w L L over random unsaturated pixels."""
    obs = problem.observations
    index = rng.integers(len(obs), size=pixels)
    index = index[~obs.clipped[index]] if (~obs.clipped[index]).any() else index
    problem.renderer.set(x)
    a, b = (problem.renderer.radiance(*obs.rays(index, rng), step_seed(rng)) for _ in range(2))
    weight = 1 / (obs.rgb[index] + SHADE) ** 2  # a and b are independent: their noise does not bias
    return float(
        (weight * 0.5 * (a + b) * obs.rgb[index]).sum() / np.maximum((weight * a * b).sum(), 1e-9)
    )


def refine(
    problem: Problem,
    small: Problem,
    x: Explanation,
    settings: Refine,
    seed: int,
    rescale: bool = True,
) -> tuple[Explanation, dict]:
    """Run Eq. 17 from a sample `x`. `problem` renders at full texture size, `small` at COARSE.
    Returns maps and facts.

    rescale: whether the light's scale is refined; not where the sampler drew it.
    """
    rng = np.random.default_rng([977, seed])
    coarse = resize_explanation(x, small.renderer.texture)
    scale = (
        float(np.clip(light_scale(small, coarse, 8 * settings.pixels, rng), 0.5, 2.0))
        if rescale
        else 1.0
    )
    light = (x.light * scale).astype(np.float32)
    coarse, losses = replace(coarse, light=light), []
    coarse, before = base_color_block(small, coarse, 4, rng)
    materials = Materials(coarse, settings.learning_rate, small.roughness_min)
    with Bar(f"refine {seed}", max(settings.steps, 1)) as bar:
        for k in range(settings.steps):
            materials.decay(settings.learning_rate * 0.1 ** (k / settings.steps))
            now = materials.explanation(light)
            g = small.gradient(now, small.batch(settings.pixels, settings.spp, rng), step_seed(rng))
            materials.step(g)
            losses.append(g.loss)
            bar.step(f"loss {np.mean(losses[-20:]):.4f}")
    full = resize_explanation(materials.explanation(light), settings.texture)
    for spp in (4, 8):
        full, last = base_color_block(problem, full, spp, rng)
    known = (
        splat(problem.observations.uv, np.ones((len(problem.observations), 1)), settings.texture)[
            ..., 0
        ]
        > 1e-3
    )
    full = replace(full, roughness=fill(full.roughness, known), metallic=fill(full.metallic, known))
    return full, {
        "light_scale": scale,
        "loss_before": before,
        "loss_last_update": last,
        "seen_share_of_texels": float(known.mean()),
    }
