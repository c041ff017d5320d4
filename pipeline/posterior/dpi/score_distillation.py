"""`sds`: score distillation, the ablation of DPI. An optimiser takes the prior's score as one more
gradient (Poole et al. 2023); it finds a mode, it does not sample.
"""

from __future__ import annotations

import torch

from pipeline.base.config import Sample
from pipeline.base.progress import Bar
from pipeline.posterior.dpi.as_published import CODE_DEVIATION, material_step
from pipeline.posterior.dpi.light_of_code import (
    as_light,
    decoded,
    finished_sample,
    slope_in_code,
)
from pipeline.posterior.material_optimizer import MaterialOptimizer
from pipeline.posterior.problem import Problem, renderer_seed
from pipeline.posterior.random_numbers import generators
from pipeline.prior.protocol import Prior
from pipeline.prior.schedule import sigma
from pipeline.prior.value_code import scale_of
from pipeline.render.renderer import Explanation, resize_explanation

LEVELS = (20, 600)  # noise levels of the T that one is drawn from at every step
PRIOR_WEIGHT = 0.02  # of the prior's slope against the data term's


def prior_slope(
    prior: Prior, code: torch.Tensor, level: float, label: str | None, noise: torch.Generator
) -> torch.Tensor:
    """The prior's slope in the code (1, 3, h, w), per entry: towards what the network makes of the
    code under noise of standard deviation `level`.
    """
    noisy = code + level * torch.randn(code.shape, generator=noise)
    clean = prior.denoise(noisy, level, label)
    return PRIOR_WEIGHT * (code - clean) / (code.numel() * max(level, 0.1))


def sds(
    problem: Problem, prior: Prior, start: Explanation, settings: Sample, seed: int
) -> tuple[Explanation, dict]:
    """One optimum from a random code; arguments and result as `dpi_paper`."""
    rng, noise = generators(seed)
    light_scale = scale_of(start.light)
    first = resize_explanation(start, settings.texture)
    materials = MaterialOptimizer(first, settings.learning_rate, problem.roughness_min)

    code = CODE_DEVIATION * torch.randn((1, 3, prior.height, prior.width), generator=noise)
    code.requires_grad_(True)
    adam = torch.optim.Adam([code], 2 * settings.learning_rate)
    losses = []

    with Bar(f"sample {seed}", settings.steps) as bar:
        for _ in range(settings.steps):
            radiance = decoded(prior, code, light_scale)
            explanation = materials.explanation(as_light(radiance))
            batch = problem.batch(settings.pixels, settings.spp, rng)
            gradient = problem.gradient(explanation, batch, renderer_seed(rng))

            slope = slope_in_code(radiance, gradient.light, code)
            level = sigma(int(rng.integers(*LEVELS)))
            with torch.no_grad():
                code.grad = slope + prior_slope(prior, code, level, settings.label, noise)
            adam.step()
            material_step(materials, gradient)

            losses.append(gradient.loss)
            bar.step(f"loss {gradient.loss:.4f}")

    sample = finished_sample(prior, code, light_scale, materials)
    return sample, {"scale": light_scale, "loss_first": losses[0], "loss_last": losses[-1]}
