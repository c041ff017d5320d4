"""`map`: the fit itself as a sampler, for comparison."""

from __future__ import annotations

from pipeline.base.config import Sample
from pipeline.posterior.problem import Problem
from pipeline.prior.protocol import Prior
from pipeline.prior.value_code import scale_of
from pipeline.render.envmap import resample_area
from pipeline.render.renderer import Explanation, resize_explanation


def point_estimate(
    problem: Problem, prior: Prior, start: Explanation, settings: Sample, seed: int
) -> tuple[Explanation, dict]:
    """The fit `start`, the same for every seed, at `settings.texture` and the prior's light size;
    and the light's scale.
    """
    explanation = resize_explanation(start, settings.texture)
    explanation.light = resample_area(start.light, prior.height, prior.width)
    return explanation, {"scale": scale_of(start.light)}
