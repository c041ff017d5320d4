"""Roughness and metallic maps under Adam, through the path tracer, with the light held."""

from __future__ import annotations

import numpy as np

from pipeline.base.config import Refine
from pipeline.base.progress import Bar
from pipeline.posterior.material_optimizer import MaterialOptimizer
from pipeline.posterior.problem import Problem, renderer_seed
from pipeline.render.renderer import Explanation


def move_gloss(
    problem: Problem,
    explanation: Explanation,
    settings: Refine,
    moves: np.ndarray,
    bar: Bar,
    rng: np.random.Generator,
) -> Explanation:
    """All three maps after `settings.steps` steps of Adam through the path tracer, light held.
    moves (t, t): texels whose roughness and metallic are moved at all.
    """
    materials = MaterialOptimizer(explanation, settings.learning_rate, problem.roughness_min)
    for name in ("roughness", "metallic"):
        now = getattr(explanation, name)
        low, high = materials.bounds[name]
        materials.bounds[name] = np.where(moves, low, now), np.where(moves, high, now)

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
