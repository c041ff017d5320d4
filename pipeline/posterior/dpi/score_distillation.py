"""Score distillation, the ablation of DPI: an optimiser that takes the prior's score as one more
gradient (Poole et al. 2023).
"""

from __future__ import annotations

import numpy as np
import torch

from pipeline.base.config import Sample
from pipeline.base.progress import Bar
from pipeline.posterior.problem import Materials, Problem, generators, guided_result, step_seed
from pipeline.prior.schedule import sigma
from pipeline.prior.value_code import scale_of
from pipeline.render.renderer import Explanation, resize_explanation

SDS_LEVELS = (
    20,
    600,
    # steps of the schedule that score distillation draws from  # steps of the schedule that levels
    # are drawn from
)
# of the prior's pull against the data term's  # of the prior's pull against the data term's
SDS_WEIGHT = 0.02


def sds(
    problem: Problem, prior, start: Explanation, settings: Sample, seed: int
) -> tuple[Explanation, dict]:
    """Score distillation (Poole et al. 2023), DPI's ablation: an optimiser with the prior's score
    as one more gradient.
    """
    rng, noise = generators(settings, seed)
    scale, losses = scale_of(start.light), []
    materials = Materials(
        resize_explanation(start, settings.texture), settings.learning_rate, problem.roughness_min
    )
    x = (0.5 * torch.randn((1, 3, prior.height, prior.width), generator=noise)).requires_grad_(True)
    adam = torch.optim.Adam([x], 2 * settings.learning_rate)
    with Bar(f"sample {seed}", settings.steps) as bar:
        for _ in range(settings.steps):
            radiance = scale * prior.decode(x)[0]
            light = np.ascontiguousarray(radiance.detach().numpy().transpose(1, 2, 0))
            g = problem.gradient(
                materials.explanation(light),
                problem.batch(settings.pixels, settings.spp, rng),
                step_seed(rng),
            )
            (pull,) = torch.autograd.grad(
                (
                    radiance * torch.from_numpy(np.ascontiguousarray(g.light.transpose(2, 0, 1)))
                ).sum(),
                x,
            )
            level = sigma(int(rng.integers(*SDS_LEVELS)))
            with torch.no_grad():
                clean = prior.denoise(
                    x + level * torch.randn(x.shape, generator=noise), level, settings.label
                )
                x.grad = pull + SDS_WEIGHT * (x - clean) / (x.numel() * max(level, 0.1))
            adam.step()
            materials.step(g)
            losses.append(g.loss)
            bar.step(f"loss {g.loss:.4f}")
    return guided_result(prior, x, scale, materials, losses[0], losses[-1])
