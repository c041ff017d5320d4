"""A refined sample before photos that its base colour is not made from."""

from dataclasses import replace

import numpy as np

from pipeline.base.config import Refine
from pipeline.posterior.judge import judge
from pipeline.posterior.problem import Problem
from pipeline.render.stacking import weights
from tests.posterior.test_ladder import photographed

SETTINGS = Refine(texture=64, shading_pixels=40_000)


def made_of(truth, roughness, metallic):
    """The truth with one roughness and one metallic all over."""
    flat = lambda value: np.full(truth.roughness.shape, value, np.float32)
    return replace(truth, roughness=flat(roughness), metallic=flat(metallic))


def test_the_gloss_that_photos_show_counts_in_the_mean(problem, toy):
    """Of a metal and of chalk the true one predicts photos left out; both are judged by the same
    pixels.
    """
    metal, chalk = made_of(toy[1], 0.25, 1), made_of(toy[1], 1, 0)
    of_metal = photographed(problem, metal)
    found = [judge(of_metal, x, SETTINGS) for x in (chalk, metal)]
    assert np.array_equal(found[0].pixel, found[1].pixel) and len(found[0].pixel) > 0
    assert found[0].residual.shape == (2, len(found[0].pixel), 3)
    assert weights(found)[1] > 0.6


def test_few_photos_do_not_judge(problem, toy):
    few = problem.observations.with_pixels(np.flatnonzero(problem.observations.view < 2))
    found = judge(Problem(few, problem.renderer, problem.roughness_min), toy[1], SETTINGS)
    assert len(found.pixel) == 0 and found.residual.shape == (2, 0, 3)
    assert (weights([found, replace(found)]) == 0.5).all()
