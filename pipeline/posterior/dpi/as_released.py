"""`dpi_code`: DPI as its authors released it, which differs from the paper (design note
`method.md`, section 3).

Four defects listed there are left out: every sample starts from its own state, every step has its
own random numbers, the light stays floating point, and the wrap column is right. Constants tied to
the authors' [0, 1] value code are carried over by RANGE, the width of our codes that theirs spans;
its clamp to that range is left out, because our codes have headroom for a sun. Base colours that
the last gauge step does not bring below 1 are cut there: an asset has none.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

from pipeline.base.config import Sample
from pipeline.base.progress import Bar
from pipeline.posterior.dpi.as_published import (
    denoised,
    level_pairs,
    material_step,
    reverse_step,
    roll,
)
from pipeline.posterior.dpi.light_of_code import (
    as_light,
    decoded,
    finished_sample,
    slope_in_code,
)
from pipeline.posterior.material_optimizer import MaterialOptimizer
from pipeline.posterior.problem import PixelBatch, Problem, renderer_seed, without_excess
from pipeline.posterior.random_numbers import generators
from pipeline.prior.protocol import Prior
from pipeline.prior.schedule import T
from pipeline.prior.value_code import scale_of
from pipeline.render.renderer import Explanation, LossAndSlope, resize_explanation

RANGE = 2.0  # four standard deviations of our codes
RATES = {"base_color": 0.02, "roughness": 0.015, "metallic": 0.01}
BASE_COLOR_START = 0.01
SHAKE = 0.05  # width of the uniform noise on the clean code, in the authors' units
LARGEST_SLOPE = 0.1  # entry of the guidance's gradient
BETAS = (0.9, 0.999)  # of the materials' Adam
GAUGE_EVERY = 3  # levels at which base colour and roughness are divided by their largest value
ROLLED_BELOW = 0.9  # share of T below which the light is turned before the network
LARGEST_ROLL = 2  # columns
INDOOR = ("indoor", "studio")  # labels under which errors are those of logs


def released_rho(t: int, outdoor: bool) -> float:
    """The released guidance weight over t / T."""
    time = t / T
    if time >= 0.9:
        return 0.01
    if not outdoor:
        return 0.1 if time >= 0.5 else 1.0
    return 0.1 + 0.9 * (0.9 - time) / 0.4 if time >= 0.5 else 0.2 + 0.8 * time / 0.5


def norm_loss(batch: PixelBatch, outdoor: bool) -> LossAndSlope:
    """The released loss, a function radiance (n, 3) -> loss, its derivative (n, 3).

    It is the un-squared L2 norm of the error, indoors that of log(1 + radiance). A saturated
    channel is no error where it is exceeded.
    """

    def loss_and_slope(radiance: np.ndarray) -> tuple[float, np.ndarray]:
        if outdoor:
            error = radiance - batch.observed
            chain = np.ones_like(radiance)
        else:
            error = np.log1p(radiance) - np.log1p(batch.observed)
            chain = 1 / (1 + radiance)

        error = without_excess(error, batch)
        norm = float(np.sqrt((error**2).sum()))
        return norm, error * chain / max(norm, 1e-9)

    return loss_and_slope


def shaken(clean: torch.Tensor, noise: torch.Generator) -> torch.Tensor:
    """The clean code with the uniform noise that is added to it before it is rendered."""
    return clean + SHAKE * RANGE * torch.rand(clean.shape, generator=noise)


def tamed(slope: torch.Tensor) -> torch.Tensor:
    """Divided by ten until no entry exceeds LARGEST_SLOPE."""
    largest = float(slope.abs().max())
    tens = max(0, int(np.ceil(np.log10(max(largest, 1e-30) / LARGEST_SLOPE))))
    return slope / 10**tens


def square_loss(batch: PixelBatch) -> LossAndSlope:
    """The released loss of the materials, the mean squared error of radiance, indoors too. A
    saturated channel is no error where it is exceeded.
    """

    def loss_and_slope(radiance: np.ndarray) -> tuple[float, np.ndarray]:
        error = without_excess(radiance - batch.observed, batch)
        return float((error**2).mean()), 2 * error / error.size

    return loss_and_slope


def small_roll(t: int, rng: np.random.Generator) -> int:
    """Columns by which the light is turned at level t, in place of Eq. 19's any."""
    return int(rng.integers(LARGEST_ROLL + 1)) if t < ROLLED_BELOW * T else 0


def two_views(
    problem: Problem, settings: Sample, rng: np.random.Generator
) -> tuple[PixelBatch, PixelBatch]:
    """Pixels of one random view for the guidance, and of another for the materials."""
    guiding, other = (
        problem.batch(settings.pixels, settings.spp, rng, int(view))
        for view in rng.integers(len(problem.observations.views), size=2)
    )
    return guiding, other


def reset_gauge(materials: MaterialOptimizer) -> None:
    """Divide base colour and roughness by their largest value, in place: light and albedo are known
    only up to a common factor, and this is the authors' choice of it.
    """
    for name in ("base_color", "roughness"):
        values = materials.values[name]
        values /= max(float(values.max()), 1e-8)


def dpi_code(
    problem: Problem, prior: Prior, start: Explanation, settings: Sample, seed: int
) -> tuple[Explanation, dict]:
    """One sample by the released algorithm; arguments and result as `dpi_paper`, whose equations
    are named in the comments.
    """
    rng, noise = generators(seed)
    outdoor = settings.label not in INDOOR
    light_scale = scale_of(start.light)
    first = resize_explanation(start, settings.texture)
    first = replace(first, base_color=np.full_like(first.base_color, BASE_COLOR_START))
    materials = MaterialOptimizer(first, RATES, problem.roughness_min, BETAS, blurred=False)
    materials.bounds["base_color"] = (0.0, np.inf)
    code = torch.randn((1, 3, prior.height, prior.width), generator=noise)
    losses = []

    pairs = level_pairs(settings.steps)
    with Bar(f"sample {seed}", len(pairs)) as bar:
        for t, s in pairs:
            columns = small_roll(t, rng)
            noisy = roll(code, columns).requires_grad_(True)  # Eq. 19
            clean = denoised(prior, noisy, t, settings.label)  # Eq. 7
            radiance = decoded(prior, shaken(clean, noise), light_scale)

            explanation = materials.explanation(as_light(radiance, columns))
            guiding, other = two_views(problem, settings, rng)
            loss = norm_loss(guiding, outdoor)
            gradient = problem.gradient(explanation, guiding, renderer_seed(rng), loss)

            slope = tamed(slope_in_code(radiance, gradient.light, noisy, columns))
            move = RANGE * released_rho(t, outdoor) * slope  # in place of Eq. 13's `guidance`
            with torch.no_grad():
                code = roll(reverse_step(clean, noisy, t, s, noise) - move, -columns)

            unshaken = as_light(decoded(prior, clean, light_scale), columns)
            explanation = materials.explanation(unshaken)
            loss = square_loss(other)
            of_other = problem.gradient(explanation, other, renderer_seed(rng), loss)
            material_step(materials, of_other)  # Eq. 16
            if t % GAUGE_EVERY == 0:
                reset_gauge(materials)

            losses.append(gradient.loss)
            bar.step(f"loss {gradient.loss:.3f}")

    materials.values["base_color"].clamp_(max=1)
    sample = finished_sample(prior, code, light_scale, materials)
    return sample, {"scale": light_scale, "loss_first": losses[0], "loss_last": losses[-1]}
