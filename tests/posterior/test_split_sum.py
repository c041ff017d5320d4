"""Split-sum shading: exact where nothing is sharp or hidden, near the path tracer's direct light on
a ball, blind to shadows; its gradient, and the two samplers with less light transport.
"""

import numpy as np
import pytest
import torch

from pipeline.base.config import Sample
from pipeline.posterior.illumination.descent import with_direct_light, with_split_sum
from pipeline.posterior.illumination.split_sum import (
    COSINES,
    ROUGHNESS,
    SplitSum,
    facet_albedo,
    prefilters,
)
from pipeline.posterior.problem import Problem
from pipeline.posterior.samplers import SAMPLERS
from pipeline.prior.load import load_prior
from pipeline.render.envmap import directions
from pipeline.render.renderer import Explanation, Renderer
from tests.seeds import numpy_rng, seeded


def material(roughness: float, metallic: float, light: np.ndarray) -> Explanation:
    gloss = lambda value: np.full((32, 32), value, np.float32)
    color = np.tile(np.float32([0.7, 0.4, 0.2]), (32, 32, 1))
    return Explanation(light.astype(np.float32), color, gloss(roughness), gloss(metallic))


def smooth_light() -> np.ndarray:
    d = directions(32, 64)
    return np.exp(d @ np.array([[0.8, 0.5, 0.1], [0.6, 0.6, 0.7], [-0.5, 0.2, 0.3]]))


def tensors(x: Explanation) -> dict[str, torch.Tensor]:
    names = ("light", "base_color", "roughness", "metallic")
    return {name: torch.from_numpy(getattr(x, name)) for name in names}


def batch_of(problem: Problem):
    return problem.batch(300, 2, numpy_rng(0))


def pictures(problem: Problem, x: Explanation) -> tuple[np.ndarray, np.ndarray]:
    """Radiance (300, 3) by split sum, and by path-traced direct light."""
    batch = batch_of(problem)
    o, d = batch.origins, batch.directions
    split = with_split_sum(problem)
    assert isinstance(split, SplitSum)
    ours = split.shaded(tensors(x), o.reshape(-1, 3), d.reshape(-1, 3)).reshape(2, -1, 3).mean(0)

    direct = with_direct_light(problem).renderer
    direct.set(x)
    traced = [direct.radiance(o[k % 2], d[k % 2], seeded(k)) for k in range(256)]
    return ours.numpy(), np.mean(traced, axis=0)


def test_prefilters_keep_a_constant_light():
    sums = prefilters(16).sum(-1)
    np.testing.assert_allclose(sums[:-1], 1, rtol=1e-4)
    np.testing.assert_allclose(sums[-1], np.pi, rtol=1e-4)


def test_a_sharp_facet_shows_the_light_and_a_rough_one_its_half():
    h = 16
    light = np.zeros(2 * h * h, np.float32)
    light[5 * 2 * h + 3] = 1
    shown = prefilters(h) @ torch.from_numpy(light)
    assert int(shown[0].argmax()) == int(light.argmax()) and shown[0].max() > 0.5
    spread = (shown > 0.01 * shown.amax(1, keepdim=True)).sum(1)
    assert (spread[:-1].diff() >= 0).all()


def test_facets_reflect_no_more_than_arrives():
    """A + B is the albedo of a white metal, all of the light where it is smooth."""
    white = facet_albedo().sum(0)
    assert white.min() > 0.3 and white.max() < 1.001
    np.testing.assert_allclose(white[0, COSINES > 0.2], 1, atol=0.02)
    assert (white[:, -1].diff() < 1e-3).all() and len(ROUGHNESS) == len(white)


@pytest.mark.parametrize(("roughness", "metallic"), [(1.0, 0.0), (0.4, 0.0), (0.3, 1.0)])
def test_a_convex_object_looks_as_path_traced(problem, roughness, metallic):
    """Split sum leaves out the highlight's stretch at grazing angles: a few per cent."""
    ours, traced = pictures(problem, material(roughness, metallic, smooth_light()))
    error = np.abs(ours - traced).mean(0) / traced.mean(0)
    assert error.max() < 0.06


def test_gradient_is_a_difference(problem):
    x = material(0.4, 0.3, smooth_light())
    split, batch = with_split_sum(problem), batch_of(problem)
    gradient = split.gradient(x, batch, seeded(0))
    rng = numpy_rng(2)
    for name, size in (
        ("light", 0.2),
        ("base_color", 0.05),
        ("roughness", 0.02),
        ("metallic", 0.05),
    ):
        way = rng.random(getattr(x, name).shape).astype(np.float32)
        ends = []
        for sign in (-1, 1):
            moved = x.copy()
            setattr(moved, name, getattr(x, name) + sign * 0.05 * size * way)
            ends.append(split.gradient(moved, batch, seeded(0)).loss)
        slope = float((getattr(gradient, name) * way).sum())
        assert slope == pytest.approx((ends[1] - ends[0]) / (0.1 * size), rel=0.05), name


def test_direct_light_is_the_same_problem_without_bounces(problem):
    other = with_direct_light(problem)
    assert other.renderer.max_depth == 2 < problem.renderer.max_depth
    assert other.observations is problem.observations
    assert other.renderer.light_shape == problem.renderer.light_shape
    assert (other.roughness_min, other.normal_error) == (0.1, problem.normal_error)


@pytest.mark.parametrize("name", ["direct_light", "split_sum"])
def test_samplers_explain_the_photos_better_than_where_they_begin(problem, start, name):
    settings = Sample(prior="prior_tiny", light=16, steps=25, pixels=400, spp=2, texture=32)
    bare = Problem(problem.observations, Renderer(problem.renderer.mesh, 32, 16, 3), 0.1)
    begin = material(0.5, 0.05, np.full((32, 64, 3), start[0].light.mean()))
    x, facts = SAMPLERS[name](bare, load_prior("prior_tiny"), begin, settings, seeded(0))
    assert facts["loss"] < 0.7 * facts["loss_first"]
    assert x.light.shape == (16, 32, 3) and (x.light > 0).all()
