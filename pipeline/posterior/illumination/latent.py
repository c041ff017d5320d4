"""A light that a trained generator makes of latent numbers, under Adam; samplers that invert it.

min over z, s, k of sum_i || y_i - R(s G(z), k, c_i) ||^2 + w mean(z^2)

with G(z) the light, s its scale and k the materials; z ~ N(0, I) under the prior, so that draws of
it have mean(z^2) = 1, and w is the data term at the fit: both terms are as large there. Adam begins
at the best of z = 0, where Gardner et al. 2022 begin, and a few draws.
"""

from __future__ import annotations

import numpy as np
import torch

from pipeline.base.config import Sample
from pipeline.posterior.illumination.descent import Descent, begun, data_term, descend
from pipeline.posterior.material_optimizer import BETAS
from pipeline.posterior.problem import Problem, renderer_seed
from pipeline.posterior.random_numbers import generators
from pipeline.prior.generators import LightGenerator, load_generator
from pipeline.prior.protocol import Prior
from pipeline.prior.value_code import scale_of
from pipeline.render.envmap import mean_radiance
from pipeline.render.renderer import Explanation

STARTS = 16  # draws of z that Adam may begin at


class LatentLight:
    """s decode(G(z)), (h, 2h, 3); z (1, *generator.latents) and log s move. `level`: the mean
    radiance that it begins with; `weight`: of mean(z^2).
    """

    def __init__(
        self,
        generator: LightGenerator,
        z: torch.Tensor,
        height: int,
        level: float,
        weight: float,
        learning_rate: float,
    ):
        self.generator = generator
        self.height = height
        self.weight = weight
        self.z = z.clone().requires_grad_(True)
        self.log_scale = torch.zeros(1, requires_grad=True)
        with torch.no_grad():
            begin = float(mean_radiance(self.light()).mean())
            self.log_scale += float(np.log(level / begin))
        self.adam = torch.optim.Adam([self.z, self.log_scale], learning_rate, betas=BETAS)

    def _radiance(self) -> torch.Tensor:
        made = self.generator.code.decode(self.generator.codes(self.z, self.height))
        return made[0].permute(1, 2, 0) * self.log_scale.exp()

    def _penalty(self) -> torch.Tensor:
        return self.weight * self.z.square().mean()

    def penalty(self, light: np.ndarray) -> tuple[float, float]:
        """The prior's term at the present z, and 0 for its slope in the light: `step` takes it."""
        return float(self._penalty().detach()), 0.0

    def light(self) -> np.ndarray:
        """Radiance (h, 2h, 3)."""
        with torch.no_grad():
            return self._radiance().contiguous().numpy()

    def step(self, slope: np.ndarray, light: np.ndarray) -> None:
        """One step of Adam, for the loss's `slope` in the radiance at `light`."""
        self.adam.zero_grad()
        self._radiance().backward(torch.from_numpy(np.asarray(slope, np.float32)))
        self._penalty().backward()
        self.adam.step()

    def set_learning_rate(self, learning_rate: float) -> None:
        self.adam.param_groups[0]["lr"] = learning_rate


def best_start(
    problem: Problem,
    first: Explanation,
    candidates: list[LatentLight],
    settings: Sample,
    rng: np.random.Generator,
) -> LatentLight:
    """The candidate that explains one batch best with the materials of `first`; pixels and paths
    are the same for all.
    """
    seed = renderer_seed(rng)
    x = first.copy()
    losses = []
    for candidate in candidates:
        x.light = candidate.light()
        losses.append(data_term(problem, x, settings, np.random.default_rng(seed), batches=1))
    return candidates[int(np.argmin(losses))]


def inverted(name: str) -> Descent:
    """The sampler of the generator whose weights are weights/generators/`name`.safetensors."""

    def sampler(
        problem: Problem, prior: Prior, start: Explanation, settings: Sample, seed: int
    ) -> tuple[Explanation, dict]:
        """One optimum; arguments and result as `dpi_paper`."""
        rng, noise = generators(seed)
        generator = load_generator(name)
        first, level = begun(start, prior, settings)
        weight = data_term(problem, first, settings, rng)

        z = torch.randn((STARTS + 1, 1, *generator.latents), generator=noise)
        z[0] = 0
        rate = 2 * settings.learning_rate
        make = lambda one: LatentLight(generator, one, prior.height, level, weight, rate)
        light = best_start(problem, first, [make(one) for one in z], settings, rng)

        x, facts = descend(problem, first, light, settings, seed, rng, light.penalty)
        return x, facts | {"scale": scale_of(start.light), "weight": weight}

    return sampler
