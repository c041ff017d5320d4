"""Optima of the data term with a prior of the light, or with less light transport: the fit goes on,
with one term more, another parametrisation of the light, or another model of shading.

All begin at the fit, which has no prior, and take `sample.steps` steps of Adam at a rate that falls
tenfold, through the same path tracer and over the same random pixels as the fit (fit.py). They find
one optimum; the seed changes pixels and paths, and the first weights of a network.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np
import torch

from pipeline.base.config import Sample
from pipeline.base.progress import Bar
from pipeline.posterior.fit import LightOptimizer
from pipeline.posterior.illumination.deep_image import NetworkLight
from pipeline.posterior.illumination.harmonics import HarmonicLight
from pipeline.posterior.illumination.penalties import PENALTIES, Penalty
from pipeline.posterior.illumination.split_sum import SplitSum
from pipeline.posterior.material_optimizer import MaterialOptimizer
from pipeline.posterior.problem import Problem, renderer_seed
from pipeline.posterior.random_numbers import generators
from pipeline.prior.protocol import Prior
from pipeline.prior.value_code import scale_of
from pipeline.render.envmap import mean_radiance, resample_area
from pipeline.render.renderer import Explanation, Renderer, resize_explanation

Descent = Callable[[Problem, Prior, Explanation, Sample, int], tuple[Explanation, dict]]
LOSS_STEPS = 8  # batches that the data term at the fit is averaged over
DARKEST = 1e-4  # of the mean radiance, from which the light moves
DIRECT = 2  # the renderer's depth at which surfaces do not light each other


class MovedLight(Protocol):
    """A light under Adam."""

    def light(self) -> np.ndarray: ...

    def step(self, slope: np.ndarray, light: np.ndarray) -> None: ...

    def set_learning_rate(self, learning_rate: float) -> None: ...


def penalised(penalty: Penalty, light: np.ndarray, level: float) -> tuple[float, np.ndarray]:
    """Value of a penalty of light / level, and its slope in the light (h, 2h, 3)."""
    radiance = torch.from_numpy(light).requires_grad_(True)
    value = penalty(radiance / level)
    (slope,) = torch.autograd.grad(value, radiance)
    return float(value.detach()), slope.numpy()


def data_term(
    problem: Problem,
    x: Explanation,
    settings: Sample,
    rng: np.random.Generator,
    batches: int = LOSS_STEPS,
) -> float:
    """The data term at `x`, mean over batches."""
    losses = []
    for _ in range(batches):
        batch = problem.batch(settings.pixels, settings.spp, rng)
        problem.renderer.set(x)
        paths = [
            problem.renderer.radiance(o, d, renderer_seed(rng))
            for o, d in zip(batch.origins, batch.directions)
        ]
        losses.append(problem.relative_loss(batch)(np.mean(paths, axis=0))[0])
    return float(np.mean(losses))


def equal_weight(
    problem: Problem,
    x: Explanation,
    penalty: Penalty,
    level: float,
    settings: Sample,
    rng: np.random.Generator,
) -> float:
    """The weight at which penalty and data term are equal at the fit `x`."""
    value, _ = penalised(penalty, x.light, level)
    return data_term(problem, x, settings, rng) / max(value, 1e-12)


def descend(
    problem: Problem,
    first: Explanation,
    light: MovedLight,
    settings: Sample,
    seed: int,
    rng: np.random.Generator,
    slope_of: Callable[[np.ndarray], np.ndarray | float],
) -> tuple[Explanation, list[float]]:
    """Adam on light and materials; slope_of(light) is added to the data term's slope in the light.
    Returns where it ends, and the data term of every step.
    """
    rate = 2 * settings.learning_rate
    materials = MaterialOptimizer(first, rate, problem.roughness_min)
    losses = []
    with Bar(f"sample {seed}", settings.steps) as bar:
        for step in range(settings.steps):
            now = rate * 0.1 ** (step / settings.steps)
            materials.set_learning_rate(now)
            light.set_learning_rate(now)

            x = materials.explanation(light.light())
            batch = problem.batch(settings.pixels, settings.spp, rng)
            gradient = problem.gradient(x, batch, renderer_seed(rng))
            light.step(gradient.light + slope_of(x.light), x.light)
            materials.step(gradient)
            losses.append(gradient.loss)
            bar.step(f"loss {gradient.loss:.4f}")
    return materials.explanation(light.light()).copy(), losses


def begun(start: Explanation, prior: Prior, settings: Sample) -> tuple[Explanation, float]:
    """The fit at the sizes of the sampler, and its light's mean radiance."""
    first = resize_explanation(start, settings.texture)
    light = resample_area(start.light, prior.height, prior.width)
    level = float(mean_radiance(light).mean())
    first.light = np.maximum(light, DARKEST * level)
    return first, level


def with_penalty(name: str) -> Descent:
    """The sampler of one of PENALTIES.

    min over x, k of sum_i || y_i - R(x, k, c_i) ||^2 + w P(x)

    with x the light, k the materials and P the penalty, weighted so that both terms are equal at
    the optimum without P.
    """

    def sampler(
        problem: Problem, prior: Prior, start: Explanation, settings: Sample, seed: int
    ) -> tuple[Explanation, dict]:
        """One optimum; arguments and result as `dpi_paper`."""
        rng, _ = generators(seed)
        penalty = PENALTIES[name]
        first, level = begun(start, prior, settings)
        weight = equal_weight(problem, first, penalty, level, settings, rng)

        light = LightOptimizer(first.light, 2 * settings.learning_rate)
        slope = lambda radiance: weight * penalised(penalty, radiance, level)[1]
        x, losses = descend(problem, first, light, settings, seed, rng, slope)
        facts = {"scale": scale_of(start.light), "weight": weight}
        return x, facts | {"loss_first": losses[0], "loss_last": losses[-1]}

    return sampler


def spherical_harmonics(
    problem: Problem, prior: Prior, start: Explanation, settings: Sample, seed: int
) -> tuple[Explanation, dict]:
    """One optimum whose light has the nine harmonics up to order 2 (Ramamoorthi and Hanrahan 2001);
    arguments and result as `dpi_paper`.
    """
    rng, _ = generators(seed)
    first, level = begun(start, prior, settings)
    light = HarmonicLight(first.light, 2 * settings.learning_rate)
    x, losses = descend(problem, first, light, settings, seed, rng, lambda radiance: 0.0)
    facts = {"scale": scale_of(start.light), "loss_first": losses[0], "loss_last": losses[-1]}
    return x, facts


def deep_image_prior(
    problem: Problem, prior: Prior, start: Explanation, settings: Sample, seed: int
) -> tuple[Explanation, dict]:
    """One optimum whose light an untrained network draws (deep_image.py). It begins at a constant
    light and the fit's materials; arguments and result as `dpi_paper`.
    """
    rng, noise = generators(seed)
    first, _ = begun(start, prior, settings)
    light = NetworkLight(first.light, 2 * settings.learning_rate, noise)
    x, losses = descend(problem, first, light, settings, seed, rng, lambda radiance: 0.0)
    facts = {"scale": scale_of(start.light), "loss_first": losses[0], "loss_last": losses[-1]}
    return x, facts


def with_direct_light(problem: Problem) -> Problem:
    """The problem in which surfaces shadow each other and do not light each other."""
    full = problem.renderer
    direct = Renderer(full.mesh, full.texture, full.light_shape[0], DIRECT, full.ground)
    return Problem(problem.observations, direct, problem.roughness_min, problem.normal_error)


def with_split_sum(problem: Problem) -> Problem:
    """The problem shaded as a rasteriser does it (split_sum.py)."""
    parts = problem.observations, problem.renderer, problem.roughness_min, problem.normal_error
    return SplitSum(*parts)


def shaded_by(shading: Callable[[Problem], Problem]) -> Descent:
    """The sampler that explains the photos by another model of shading, with no prior of the light:
    `with_direct_light` is an analogue of nvdiffrecmc (Hasselgren et al. 2022), `with_split_sum` one
    of nvdiffrec (Munkberg et al. 2022). Their regularisers and their geometry are not part of it.
    """

    def sampler(
        problem: Problem, prior: Prior, start: Explanation, settings: Sample, seed: int
    ) -> tuple[Explanation, dict]:
        """One optimum; arguments and result as `dpi_paper`."""
        rng, _ = generators(seed)
        first, _ = begun(start, prior, settings)
        light = LightOptimizer(first.light, 2 * settings.learning_rate)
        shaded = shading(problem)
        x, losses = descend(shaded, first, light, settings, seed, rng, lambda radiance: 0.0)
        facts = {"scale": scale_of(start.light), "loss_first": losses[0], "loss_last": losses[-1]}
        return x, facts

    return sampler
