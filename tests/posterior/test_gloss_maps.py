"""Whether roughness and metallic need maps, on photos that are rendered from known ones."""

from copy import copy
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from pipeline.base.config import Refine
from pipeline.base.progress import Bar
from pipeline.posterior.gloss_maps import FREEDOM, gain, simplest_gloss, split, with_pixels
from pipeline.posterior.problem import Problem
from pipeline.posterior.refine import refine, solve_base_color, units
from tests.seeds import numpy_rng, seeded


def photographed(problem, truth, seed=0):
    """The problem with photos of `truth` from the same cameras, 128 paths for each pixel."""
    observations = copy(problem.observations)
    everywhere = np.arange(len(observations))
    problem.renderer.set(truth)
    rays = lambda rng: observations.rays(everywhere, rng)
    observations.rgb = problem.renderer.mean_radiance(rays, 128, seeded(seed))
    observations.clipped = np.zeros(observations.rgb.shape, bool)
    return Problem(observations, problem.renderer, problem.roughness_min)


def solve(problem, explanation):
    return solve_base_color(problem, explanation, 4000, numpy_rng(0))[0]


def decided(problem, explanation):
    rng = numpy_rng(1)
    return simplest_gloss(problem, explanation, split(problem.observations, rng), solve, rng)


def in_halves(truth, one, other):
    """A map that is `one` left of the middle and `other` right of it."""
    image = np.full_like(truth.roughness, one)
    image[:, image.shape[1] // 2 :] = other
    return image


def test_a_map_that_wobbles_about_one_value_is_a_number(problem, toy):
    """The photos show roughness .4 and no metal; the maps add noise of their own to either."""
    truth = toy[1]
    rng = numpy_rng(0)
    noisy = replace(
        truth,
        roughness=(0.4 + rng.uniform(-0.05, 0.05, truth.roughness.shape)).astype(np.float32),
        metallic=rng.uniform(0, 0.03, truth.metallic.shape).astype(np.float32),
    )
    simple, facts = decided(problem, noisy)
    assert facts["metallic"]["chosen"] == "none" and (simple.metallic == 0).all()
    # two standard errors are exceeded by chance at one seed of forty
    found = facts["roughness"]["gain_of_the_map"]["one value"]
    assert found["nats"] < 4 * found["standard_error"]
    if facts["roughness"]["chosen"] == "one value":
        assert np.ptp(simple.roughness) == 0
        assert simple.roughness[0, 0] == pytest.approx(0.4, abs=0.01)


def test_maps_that_photos_show_stay_maps(problem, toy):
    truth = toy[1]
    mixed = replace(
        truth, roughness=in_halves(truth, 0.1, 0.8), metallic=in_halves(truth, 1.0, 0.0)
    )
    same, facts = decided(photographed(problem, mixed), mixed)
    for name in ("roughness", "metallic"):
        assert facts[name]["chosen"] == "map" and "value" not in facts[name]
        assert (getattr(same, name) == getattr(mixed, name)).all()
        for found in facts[name]["gain_of_the_map"].values():
            assert found["nats"] > 2 * found["standard_error"]


def test_maps_that_are_numbers_already_stay_what_they_are(problem, toy):
    """Candidates are the maps themselves; also where no pixel's error differs at all."""
    _, facts = decided(problem, toy[1])
    assert facts["metallic"]["chosen"] == "none"
    assert facts["roughness"]["value"] == pytest.approx(0.4)
    assert gain(np.ones(3), np.ones(3), np.arange(3)) == (0, 0)


def test_metal_all_over_is_one_value_and_not_none(problem, toy):
    truth = toy[1]
    metal = replace(truth, metallic=np.ones_like(truth.metallic))
    _, facts = decided(photographed(problem, metal), metal)
    assert facts["metallic"]["chosen"] == "one value" and facts["metallic"]["value"] == 1


def test_judging_pixels_are_whole_blocks_that_make_no_map(problem):
    observations = problem.observations
    parts = split(observations, numpy_rng(0))
    assert not set(parts.kept) & set(parts.judged)
    assert len(parts.judged) / len(observations) == pytest.approx(0.2, abs=0.03)

    name = [(*key,) for key in np.c_[observations.view, observations.pixel // 4]]
    judged = {name[k] for k in parts.judged}
    assert len(judged) == len(np.unique(parts.block))
    assert not judged & {name[k] for k in parts.kept}
    kept = with_pixels(problem, parts.kept).observations
    assert (kept.rgb == observations.rgb[parts.kept]).all() and len(kept) == len(parts.kept)


def test_a_few_blocks_judge_nothing(problem, start):
    few = with_pixels(problem, np.arange(150))
    assert split(few.observations, numpy_rng(0)) is None
    settings = Refine(steps=0, pixels=100, texture=32, shading_pixels=1000, gloss="tested")
    with Bar("refine", units(settings)) as bar:
        _, facts = refine(few, few, start[0], settings, seeded(0), bar)
    assert facts["gloss"] == {"why": "maps stay: too few blocks of pixels to judge them by"}


def test_gain_counts_blocks_and_not_pixels():
    """Errors that whole blocks share: k copies of a pixel make the gain k times as large and its
    standard error too, so no more certain; expected from scipy's density of Student's t.
    """
    simple, rich, block = np.array([3.0, 1.0, 2.0]), np.array([1.0, 2.0, 1.0]), np.array([4, 7, 9])
    nats, error = gain(simple, rich, block)
    density = lambda squared: stats.t.logpdf(np.sqrt(squared), FREEDOM)  # median of rich: 1
    of_block = density(rich) - density(simple)
    assert nats == pytest.approx(of_block.sum())
    assert error == pytest.approx(np.sqrt(3) * np.std(of_block, ddof=1))

    copies = [np.repeat(values, 50) for values in (simple, rich, block)]
    many, its_error = gain(*copies)
    assert (many, its_error) == (pytest.approx(50 * nats), pytest.approx(50 * error))


def test_a_few_wild_pixels_do_not_hide_what_all_others_say():
    """Of 4000 pixels in 400 blocks all gain a little by the maps; 1 % have errors a thousand times
    as large, which come and go.
    """
    rng = numpy_rng(0)
    rich = rng.normal(size=4000) ** 2
    simple = 1.3 * rich
    wild = rng.random(4000) < 0.01
    rich[wild], simple[wild] = rng.uniform(0, 1000, (2, wild.sum()))
    nats, error = gain(simple, rich, np.arange(4000) // 10)
    assert nats > 5 * error
    assert (simple - rich).sum() < 2 * np.sqrt(4000) * (simple - rich).std()  # a normal one's sum


def test_refinement_says_what_it_chose(problem, start):
    settings = Refine(steps=2, pixels=300, texture=32, shading_pixels=8000, gloss="tested")
    with Bar("refine", units(settings)) as bar:
        refined, facts = refine(problem, problem, start[0], settings, seeded(0), bar)
    for name in ("roughness", "metallic"):
        one = np.ptp(getattr(refined, name)) < 1e-6
        assert one == (facts["gloss"][name]["chosen"] != "map")
