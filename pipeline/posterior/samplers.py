"""SAMPLERS: every sampler by the name that a scene's `sample.method` gives.

A sampler is a function (problem, prior, start, settings, seed) -> Explanation, facts, with `start`
the fit. `split_gibbs` is the default (base/config.py, Sample.method). To add one, write such a
function and add a line here.
"""

from collections.abc import Callable

from pipeline.base.config import Sample
from pipeline.posterior.dpi.as_published import dpi_paper
from pipeline.posterior.dpi.as_released import dpi_code
from pipeline.posterior.dpi.score_distillation import sds
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
}
