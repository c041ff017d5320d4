"""The mean of samples, as an asset opens with it."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.render.renderer import NO_HIGHLIGHT
from pipeline.render.samples import mean_of
from tests.render.test_renderer import explanation

SHARE = st.floats(0, 1, width=32)
WEIGHT = st.floats(0.0625, 1, width=32)
COLOR = st.floats(0.015625, 0.96875, width=32)


def sample(color, metallic, roughness=0.5, side=8, gloss_side=4):
    """Of one colour and metallic all over, with maps of gloss and metal of their own size."""
    x = explanation(side, roughness=roughness)
    small = np.full((gloss_side, gloss_side), 1, np.float32)
    color = np.full_like(x.base_color, color)
    return replace(x, base_color=color, metallic=metallic * small, roughness=roughness * small)


def test_one_sample_has_no_mean():
    assert mean_of([explanation()], np.ones(1)) is None


@given(st.lists(st.tuples(COLOR, SHARE, WEIGHT), min_size=1, max_size=3))
def test_where_samples_disagree_about_metal_it_is_as_diffuse_as_they_are_in_the_mean(parts):
    """(1 - metallic) base colour, and metallic times base colour, are their weighted means."""
    parts = [*parts, (0.5, 0.0, 0.5), (0.5, 1.0, 0.5)]
    color, metallic, weight = np.array(parts).T
    weight = weight / weight.sum()
    mean = mean_of([sample(color, metallic) for color, metallic, _ in parts], weight)
    close = {"rtol": 1e-3, "atol": 1e-4}
    np.testing.assert_allclose(mean.base_color, weight @ color, **close)
    a, m = mean.base_color[0, 0, 0], mean.metallic[0, 0]
    np.testing.assert_allclose((1 - m) * a, weight @ ((1 - metallic) * color), **close)
    np.testing.assert_allclose(m * a, weight @ (metallic * color), **close)


@pytest.mark.parametrize("metallic", [0.0, 1.0])
def test_where_they_agree_it_lies_between_what_is_right_under_its_light_and_under_another(metallic):
    """A photo shows colour times light: .2 under 3 is .6 under 1. Under the light's mean, 2, it is
    .3, the harmonic mean; under another light .4 errs least, the linear one.
    """
    mean = mean_of([sample(0.2, metallic), sample(0.6, metallic)], np.full(2, 0.5))
    assert 0.3 < mean.base_color[0, 0, 0] < 0.4
    same = mean_of([sample(0.6, metallic), sample(0.6, metallic)], np.full(2, 0.5))
    np.testing.assert_allclose(same.base_color, 0.6, atol=1e-5)


@given(SHARE, COLOR, COLOR)
def test_samples_of_one_metallic_have_a_mean_of_it(metallic, one, other):
    mean = mean_of([sample(one, metallic), sample(other, metallic)], np.array([0.25, 0.75]))
    np.testing.assert_allclose(mean.metallic, metallic, atol=1e-6)
    assert mean.metallic.dtype == mean.base_color.dtype == np.float32


def test_black_samples_have_a_mean_too():
    mean = mean_of([sample(0.0, 0.0), sample(0.0, 1.0)], np.full(2, 0.5))
    np.testing.assert_allclose(mean.metallic, 0.5, atol=1e-6)


def test_light_and_roughness_are_weighted_means():
    samples = [explanation(seed=k, roughness=0.2 + 0.3 * k) for k in range(3)]
    weight = np.array([0.5, 0.0, 0.5])
    mean = mean_of(samples, weight)
    expected = np.average([x.light for x in samples], 0, weight)
    np.testing.assert_allclose(mean.light, expected, rtol=1e-5)
    np.testing.assert_allclose(mean.roughness, 0.5, rtol=1e-5)
    assert mean.light.dtype == np.float32


def test_the_roughness_of_a_sample_without_a_highlight_counts_only_on_its_metal():
    shiny, bare = sample(0.5, 0.0, 0.9), replace(sample(0.5, 0.0, 0.3), ior=NO_HIGHLIGHT)
    half = np.full(2, 0.5)
    np.testing.assert_allclose(mean_of([shiny, bare], half).roughness, 0.9, atol=1e-3)
    np.testing.assert_allclose(mean_of([bare, bare], half).roughness, 0.3, atol=1e-6)
    metal = replace(bare, metallic=np.ones_like(bare.metallic))
    np.testing.assert_allclose(mean_of([shiny, metal], half).roughness, 0.6, atol=1e-3)
