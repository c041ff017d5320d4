"""Roughness and metallic maps under Adam, through the path tracer, with the light held."""

from __future__ import annotations

import numpy as np

from pipeline.base.config import Refine
from pipeline.base.progress import Bar
from pipeline.posterior.material_optimizer import MaterialOptimizer
from pipeline.posterior.problem import Problem, renderer_seed
from pipeline.render.renderer import Explanation

# factor by which roughness may move from a draw: the width of what one draw believes of a region
ROUGHNESS_FACTOR = 1.3


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
    moves: np.ndarray,
    bar: Bar,
    rng: np.random.Generator,
) -> Explanation:
    """All three maps after `settings.steps` steps of Adam through the path tracer, light held;
    near: roughness stays near what it is, and metallic as it is; moves (t, t): texels whose
    roughness and metallic are moved at all.
    """
    materials = MaterialOptimizer(explanation, settings.learning_rate, problem.roughness_min)
    if near:
        stay_near(materials, explanation)
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
