"""A refined sample by photos that its base colour is not made from, for its weight in the mean."""

from __future__ import annotations

import numpy as np

from pipeline.base.config import Refine
from pipeline.posterior.ladder import Jury
from pipeline.posterior.left_out import folds
from pipeline.posterior.problem import Problem
from pipeline.posterior.refine import COARSE, FEWEST, shading_by_color
from pipeline.render.renderer import Explanation, resize_explanation
from pipeline.render.stacking import LeftOut

SEED = 4242  # of photos, pixels, rays and paths: all samples of a scene have the same


def judge(problem: Problem, refined: Explanation, settings: Refine) -> LeftOut:
    """How the light and the gloss of a refined sample predict photos that are left out in turn,
    under base colours from the other photos, on maps of moderate size.
    """
    small = problem.at_texture(min(COARSE, settings.texture))
    parts = folds(small.observations, np.random.default_rng(SEED))
    if not parts:
        return LeftOut.by_none()

    jury = Jury(small, parts, shading_by_color, settings.shading_pixels // FEWEST, SEED)
    coarse = resize_explanation(refined, small.renderer.texture)
    found = jury.residuals(coarse)
    return LeftOut(np.concatenate([fold.judged for fold in parts]), found)
