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
from pipeline.posterior.fit import BestState, LightOptimizer
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


# light (h, 2h, 3) -> value of the prior's term, and its slope in the light
PriorTerm = Callable[[np.ndarray], tuple[float, np.ndarray | float]]


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


def no_prior(light: np.ndarray) -> tuple[float, float]:
    """The term of samplers whose light has no prior, or one by its parametrisation alone."""
    return 0.0, 0.0


def descend(
    problem: Problem,
    first: Explanation,
    light: MovedLight,
    settings: Sample,
    seed: int,
    rng: np.random.Generator,
    prior_term: PriorTerm = no_prior,
) -> tuple[Explanation, dict]:
    """Adam on light and materials, down the data term plus `prior_term`. Returns the state with the
    least running mean of both, and facts: the loss at first, where it ends and what is returned.

    The last state may be worse than one before it: Adam's normalised steps follow the median of a
    slope, and where a few paths carry most of the light the median is not the mean.
    """
    rate = 2 * settings.learning_rate
    materials = MaterialOptimizer(first, rate, problem.roughness_min)
    best = BestState(settings.steps)
    losses = []
    with Bar(f"sample {seed}", settings.steps) as bar:
        for step in range(settings.steps):
            now = rate * 0.1 ** (step / settings.steps)
            materials.set_learning_rate(now)
            light.set_learning_rate(now)

            x = materials.explanation(light.light())
            batch = problem.batch(settings.pixels, settings.spp, rng)
            gradient = problem.gradient(x, batch, renderer_seed(rng))
            value, slope = prior_term(x.light)
            losses.append(gradient.loss + value)
            best.see(step, x, losses[-1])

            light.step(gradient.light + slope, x.light)
            materials.step(gradient)
            bar.step(f"loss {best.running_mean:.4f}")
    facts = {"loss_first": losses[0], "loss_last": losses[-1]}
    return best.explanation, facts | {"loss": best.loss, "best_step": best.step}


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

        def term(radiance: np.ndarray) -> tuple[float, np.ndarray]:
            value, slope = penalised(penalty, radiance, level)
            return weight * value, weight * slope

        x, facts = descend(problem, first, light, settings, seed, rng, term)
        return x, facts | {"scale": scale_of(start.light), "weight": weight}

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
    x, facts = descend(problem, first, light, settings, seed, rng)
    return x, facts | {"scale": scale_of(start.light)}


def deep_image_prior(
    problem: Problem, prior: Prior, start: Explanation, settings: Sample, seed: int
) -> tuple[Explanation, dict]:
    """One optimum whose light an untrained network draws (deep_image.py). It begins at a constant
    light and the fit's materials; arguments and result as `dpi_paper`.
    """
    rng, noise = generators(seed)
    first, _ = begun(start, prior, settings)
    light = NetworkLight(first.light, 2 * settings.learning_rate, noise)
    x, facts = descend(problem, first, light, settings, seed, rng)
    return x, facts | {"scale": scale_of(start.light)}


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
        x, facts = descend(shading(problem), first, light, settings, seed, rng)
        return x, facts | {"scale": scale_of(start.light)}

    return sampler
