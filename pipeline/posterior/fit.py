"""Point estimate of light and materials together (DPI, Eq. 15): Adam through the path tracer.

The light is exp(p), so that it stays positive and steps are relative. Gauge: (light, albedo) -> (s
light, albedo / s) leaves diffuse pictures unchanged; the fit starts with a median observed base
colour of ALBEDO_START and drifts from there only as far as the photos (specular light,
interreflection) ask. Best state by a running mean is kept.
"""

from __future__ import annotations

import numpy as np
import torch

from pipeline.base.config import Fit
from pipeline.base.images import luminance
from pipeline.base.progress import Bar
from pipeline.posterior.problem import Materials, Problem, step_seed
from pipeline.render.renderer import Explanation

ALBEDO_START, ROUGHNESS_START, METALLIC_START = 0.35, 0.5, 0.05


def start(problem: Problem, texture: int) -> Explanation:
    """Grey, rough, non-metallic, under a constant light that makes the median pixel right."""
    level = float(np.median(luminance(problem.observations.rgb)))
    light = np.full(problem.renderer.light_shape, max(level, 1e-4) / ALBEDO_START, np.float32)
    full = lambda *shape, value: np.full((texture, texture) + shape, value, np.float32)
    return Explanation(
        light, full(3, value=ALBEDO_START), full(value=ROUGHNESS_START), full(value=METALLIC_START)
    )


def fit(problem: Problem, settings: Fit) -> tuple[Explanation, dict]:
    """Run Eq. 15; returns the best explanation and {"loss_start", "loss_end", "best_step"}."""
    rng = np.random.default_rng(settings.seed)
    x = start(problem, settings.texture)
    materials = Materials(x, settings.learning_rate, problem.roughness_min)
    log_light = torch.from_numpy(np.log(x.light))
    light_adam = torch.optim.Adam([log_light], settings.learning_rate, betas=(0.9, 0.99))
    smooth, best, first = None, (np.inf, x, 0), None
    with Bar("fit", settings.steps) as bar:
        for k in range(settings.steps):
            rate = settings.learning_rate * 0.1 ** (
                k / settings.steps
            )  # a constant rate diverges late
            materials.decay(rate)
            light_adam.param_groups[0]["lr"] = rate
            x = materials.explanation(torch.exp(log_light).numpy())
            g = problem.gradient(
                x, problem.batch(settings.pixels, settings.spp, rng), step_seed(rng)
            )
            smooth = g.loss if smooth is None else 0.9 * smooth + 0.1 * g.loss
            first = g.loss if first is None else first
            if k >= settings.steps // 2 and smooth < best[0] or k == 0:
                best = (
                    smooth if k else np.inf,
                    Explanation(*(v.copy() for v in vars(x).values())),
                    k,
                )
            log_light.grad = torch.from_numpy(np.ascontiguousarray(g.light * x.light))
            light_adam.step()
            materials.step(g)
            bar.step(f"loss {smooth:.4f}")
    return best[1], {
        "loss_start": first,
        "loss_end": best[0] if np.isfinite(best[0]) else smooth,
        "best_step": best[2],
    }
