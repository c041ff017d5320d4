"""SAMPLERS: every sampler by the name that a scene's `sample.method` gives.

A sampler draws by a function (problem, prior, start, settings, seed) -> Explanation, facts, with
`start` the fit. `split_gibbs` is the default (base/config.py, Sample.method). To add one, write
such a function, and add a line here and its name there.
"""

from collections.abc import Callable
from dataclasses import dataclass

from pipeline.base.config import Sample
from pipeline.posterior.dpi.as_published import dpi_paper
from pipeline.posterior.dpi.as_released import dpi_code
from pipeline.posterior.dpi.score_distillation import sds
from pipeline.posterior.illumination.descent import (
    deep_image_prior,
    shaded_by,
    spherical_harmonics,
    with_direct_light,
    with_penalty,
    with_split_sum,
)
from pipeline.posterior.illumination.latent import inverted
from pipeline.posterior.point_estimate import point_estimate
from pipeline.posterior.problem import Problem
from pipeline.posterior.split_gibbs.sampler import gaussian, split_gibbs
from pipeline.prior.protocol import Prior
from pipeline.render.renderer import Explanation

Draw = Callable[[Problem, Prior, Explanation, Sample, int], tuple[Explanation, dict]]


@dataclass(frozen=True)
class Sampler:
    """draw: the function; scale_drawn: as in `DrawFacts`; looks_at_the_light: whether the light
    that photos look into (render/surroundings.py) is data to it; the others begin at a fit that
    knows of it.
    """

    draw: Draw
    scale_drawn: bool
    looks_at_the_light: bool

    def __call__(
        self, problem: Problem, prior: Prior, start: Explanation, settings: Sample, seed: int
    ) -> tuple[Explanation, dict]:
        return self.draw(problem, prior, start, settings, seed)


def descent(draw: Draw) -> Sampler:
    """A sampler that leaves the light's scale to refinement and looks at the object alone."""
    return Sampler(draw, scale_drawn=False, looks_at_the_light=False)


SAMPLERS: dict[str, Sampler] = {
    "split_gibbs": Sampler(split_gibbs, scale_drawn=True, looks_at_the_light=True),
    "gaussian": Sampler(gaussian, scale_drawn=True, looks_at_the_light=True),
    "dpi_paper": descent(dpi_paper),
    "dpi_code": descent(dpi_code),
    "sds": descent(sds),
    "map": Sampler(point_estimate, scale_drawn=False, looks_at_the_light=True),
    "global_norm": descent(with_penalty("global_norm")),
    "total_variation": descent(with_penalty("total_variation")),
    "chromaticity": descent(with_penalty("chromaticity")),
    "spherical_harmonics": descent(spherical_harmonics),
    "deep_image_prior": descent(deep_image_prior),
    "direct_light": descent(shaded_by(with_direct_light)),
    "split_sum": descent(shaded_by(with_split_sum)),
    "gan_latent": descent(inverted("gan_latent")),
    "equivariant_field": descent(inverted("equivariant_field")),
}
