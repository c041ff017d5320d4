"""Shading between traced pixels."""

import numpy as np

from pipeline.posterior.problem import Problem
from pipeline.posterior.shading import regress, shade, split_picture
from pipeline.posterior.textures import gather
from tests.seeds import numpy_rng


def test_regression_follows_what_is_linear_in_the_guide():
    rng = numpy_rng(0)
    at = rng.uniform(-0.5, 7.5, (4000, 2))
    guide = rng.normal(size=(4000, 4))
    values = guide @ rng.normal(size=(4, 6)) + 3
    cells = regress(at[:3000], guide[:3000], values[:3000], at.max(0))
    error = cells.predict(at[3000:], guide[3000:]) - values[3000:]
    assert np.abs(error).max() < 0.5 and np.abs(error).mean() < 0.1


def test_flat_cells_take_the_mean_and_empty_ones_their_neighbours():
    rng = numpy_rng(0)
    at = rng.uniform(-0.5, 3.4, (2000, 2))
    guide = np.ones((2000, 4))
    values = rng.normal(2, 0.5, (2000, 1))
    cells = regress(at, guide, values, np.array([5.0, 3.0]))
    beside = np.array([[1.5, 1.5], [3.9, 1.0]])
    assert np.allclose(cells.predict(beside, guide[:2]), 2, atol=0.15)


def test_interpolated_shading_is_that_of_many_paths(problem, start):
    """A quarter of the pixels with two paths each, against 64 paths through some pixels."""
    explanation = start[0].copy()
    explanation.base_color.clip(0.02, None, out=explanation.base_color)
    rng = numpy_rng(0)
    shading = shade(problem, explanation, len(problem.observations) // 4, rng)

    some = np.arange(0, len(problem.observations), 9)
    color = gather(explanation.base_color, problem.observations.uv[some])
    few = split_picture(problem, explanation, some, 2, rng)
    many = split_picture(problem, explanation, some, 64, rng)
    picture = lambda split: color * split[0] + split[1]

    found = (shading.scaled[some], shading.rest[some])
    error = lambda split: np.sqrt(((picture(split) / picture(many) - 1) ** 2).mean())
    assert error(found) < 0.15 and error(found) < 0.5 * error(few)
    assert abs(picture(found).mean() / picture(many).mean() - 1) < 0.03


def test_normals_of_a_part_are_those_of_the_whole(problem):
    """Traced once, for pixels and for maps of any side."""
    index = np.arange(0, len(problem.observations), 7)
    part = problem.with_pixels(index)
    alone = Problem(part.observations, problem.renderer, problem.roughness_min)
    assert len(part.observations) == len(index)
    assert (part.observations.uv == problem.observations.uv[index]).all()
    assert np.allclose(part.shading_normals, alone.shading_normals, atol=1e-6)

    coarse = problem.at_texture(16)
    assert coarse.renderer.texture == 16 and problem.renderer.texture != 16
    assert coarse.observations is problem.observations
    assert coarse.shading_normals is problem.shading_normals
    assert problem.at_texture(problem.renderer.texture) is problem
