"""SAMPLERS: every sampler by the name that a scene's `sample.method` gives.

A sampler is a function (problem, prior, start, settings, seed) -> Explanation, facts, with `start`
the fit. `split_gibbs` is the default (base/config.py, Sample.method). To add one, write such a
function, and add a line here and its name there.
"""

from collections.abc import Callable

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

Sampler = Callable[[Problem, Prior, Explanation, Sample, int], tuple[Explanation, dict]]

SAMPLERS: dict[str, Sampler] = {
    "split_gibbs": split_gibbs,
    "gaussian": gaussian,
    "dpi_paper": dpi_paper,
    "dpi_code": dpi_code,
    "sds": sds,
    "map": point_estimate,
    "global_norm": with_penalty("global_norm"),
    "total_variation": with_penalty("total_variation"),
    "chromaticity": with_penalty("chromaticity"),
    "spherical_harmonics": spherical_harmonics,
    "deep_image_prior": deep_image_prior,
    "direct_light": shaded_by(with_direct_light),
    "split_sum": shaded_by(with_split_sum),
    "gan_latent": inverted("gan_latent"),
    "equivariant_field": inverted("equivariant_field"),
}

# those to which the light that photos look into (render/surroundings.py) is data; the others begin
# at a fit that knows of it
LOOKING_AT_THE_LIGHT = ("split_gibbs", "gaussian", "map")
