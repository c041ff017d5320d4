"""Scores in cases whose value is known in closed form."""

import numpy as np
import pytest
from skimage.color import rgb2lab

from pipeline.base.images import srgb_to_linear
from pipeline.render.draw_metrics import coverage, crps, held_within, sample_variance
from pipeline.render.envmap import directions, yaw_roll
from pipeline.render.light_metrics import (
    light_errors,
    light_psnr_tone_mapped,
    light_ssim,
    peak_direction,
    ssim_map,
    sun_direction_error,
)
from pipeline.render.map_metrics import map_errors
from pipeline.render.metrics import flip_map, psnr
from tests.seeds import numpy_rng


def lamp(direction, h: int = 32, width: float = 8.0) -> np.ndarray:
    """A light (h, 2h, 3) of 1 with a lamp in a direction."""
    cosine = directions(h, 2 * h) @ (np.array(direction) / np.linalg.norm(direction))
    lit = 1 + 200 * np.exp((cosine - 1) / np.radians(width) ** 2)
    return np.repeat(lit[..., None], 3, -1).astype(np.float32)


def test_noise_of_both_renders_drops_out():
    """A picture that is right but for noise scores as its systematic error alone."""
    rng = numpy_rng(0)
    shape = (200, 200, 3)
    noisy = lambda level: srgb_to_linear(np.full(shape, level) + 0.02 * rng.normal(size=shape))
    score = psnr(noisy(0.51), noisy(0.5), None, noisy(0.51), noisy(0.5))
    assert abs(score - 40) < 0.3  # an error of .01 is 40 dB; noise of .02 alone would be 31
    assert psnr(noisy(0.51), noisy(0.5), None, noisy(0.51)) < 34.5  # the truth's noise is left in


def test_albedo_errors_follow_their_scale_rules():
    rng = numpy_rng(1)
    true = rng.uniform(0.1, 0.9, (500, 3))
    grey = rng.random(500)
    truth = {"albedo": true, "roughness": grey, "metallic": 0 * grey}

    of = map_errors(0.5 * true, grey + 0.1, 0 * grey + 0.3, truth)
    assert of["albedo_mse"] == pytest.approx((0.25 * true**2).mean())
    assert of["albedo_mse_scalar"] == pytest.approx(0, abs=1e-12)
    assert of["roughness_mse"] == pytest.approx(0.01)
    assert of["metallic_mse"] == pytest.approx(0.09)

    tinted = map_errors(true * [0.5, 1.0, 0.8], grey, 0 * grey, truth)
    assert tinted["albedo_mse_channel"] == pytest.approx(0, abs=1e-12)
    assert tinted["albedo_mse"] > tinted["albedo_mse_scalar"] > 1e-3


def test_a_light_is_compared_without_its_level():
    light = lamp([1, 1, 1])
    same = light_errors(5 * light, light)
    assert same["light_psnr_tone_mapped"] == pytest.approx(100)
    assert same["light_ssim"] == pytest.approx(1)
    assert same["light_level"] == pytest.approx(np.log(5), abs=1e-6)
    assert same["sun_degrees"] < 1e-3


def test_tone_mapped_psnr_in_closed_form():
    """Two halves of .5 and 1.5 against an even light: L / (1 + L) is 1/3 and .6 against 1/2."""
    halves = np.full((16, 32, 3), 0.5, np.float32)
    halves[:, 16:] = 1.5
    error = ((1 / 3 - 1 / 2) ** 2 + (0.6 - 1 / 2) ** 2) / 2
    score = light_psnr_tone_mapped(halves, np.ones_like(halves))
    assert score == pytest.approx(-10 * np.log10(error), abs=1e-3)


@pytest.mark.parametrize("angle", [0, 45, 90, 180])
def test_sun_direction_error_is_the_angle(angle):
    light = lamp([0.2, 0.3, 1])
    turned = yaw_roll(light, 64 * angle // 360)
    at = np.array([0.2, 0.3, 1]) / np.linalg.norm([0.2, 0.3, 1])
    expected = np.degrees(np.arccos(at[1] ** 2 + (1 - at[1] ** 2) * np.cos(np.radians(angle))))
    assert sun_direction_error(turned, light) == pytest.approx(expected, abs=1)  # a pixel has 5.6
    assert peak_direction(light) @ at > np.cos(np.radians(1.5))


def test_light_ssim_has_no_seam():
    light = lamp([0, 0.2, -1])  # at the map's edge
    middle = yaw_roll(light, 32)
    other = lamp([0.5, 0.2, -1])
    there = light_ssim(other, light)
    assert there == pytest.approx(light_ssim(yaw_roll(other, 32), middle), abs=1e-6)
    assert there < 0.98


def test_ssim_of_constants_in_closed_form():
    """Of even pictures a and b only the luminance term is left: (2ab + c) / (a^2 + b^2 + c)."""
    a, b, c = 0.3, 0.6, 0.01**2
    found = ssim_map(np.full((20, 20, 3), a), np.full((20, 20, 3), b))
    np.testing.assert_allclose(found, (2 * a * b + c) / (a * a + b * b + c), rtol=1e-6)


def flip_of_greys(a: float, b: float) -> float:
    """FLIP of two even grey pictures: without edges it is the colour difference alone, here of the
    lightness, to the power .7; up to .4 of the most that there is it takes .95 of the range.
    """
    lab = rgb2lab(np.array([[[0, 1, 0], [0, 0, 1], [a] * 3, [b] * 3]], float))[0]
    lab[:, 1:] *= lab[:, :1] / 100  # chroma fades with lightness (Hunt)
    green, blue, one, other = lab
    city_block_and_euclid = abs(green[0] - blue[0]) + np.linalg.norm(green[1:] - blue[1:])
    most = city_block_and_euclid**0.7
    difference = abs(one[0] - other[0]) ** 0.7
    if difference < 0.4 * most:
        return 0.95 * difference / (0.4 * most)
    return 0.95 + 0.05 * (difference - 0.4 * most) / (0.6 * most)


@pytest.mark.parametrize("a, b", [(0, 1), (0.3, 0.6), (0.5, 0.52)])
def test_flip_of_greys_in_closed_form(a, b):
    found = flip_map(np.full((24, 24, 3), a), np.full((24, 24, 3), b))
    assert found.shape == (24, 24)
    np.testing.assert_allclose(found, flip_of_greys(a, b), atol=1e-3)


def test_flip_is_nought_for_the_same_and_lies_where_pictures_differ():
    rng = numpy_rng(5)
    picture = rng.random((96, 64, 3))
    np.testing.assert_allclose(flip_map(picture, picture), 0, atol=1e-6)
    other = picture.copy()
    other[:16] = 1 - other[:16]
    found = flip_map(other, picture)
    assert found[:16].mean() > 0.2
    # filters of the eye's resolution reach 10 pixels at 67 pixels a degree
    np.testing.assert_allclose(found[40:], 0, atol=1e-6)


def test_crps_is_its_double_sum_and_that_of_a_normal():
    rng = numpy_rng(2)
    draws, truth = rng.normal(size=(7, 5)), rng.normal(size=5)
    pairs = np.abs(draws[:, None] - draws).sum((0, 1)).mean() / (7 * 6)
    assert crps(draws, truth) == pytest.approx(np.abs(draws - truth).mean() - 0.5 * pairs)

    # at the mean of N(0, 1): (sqrt(2) - 1) / sqrt(pi) (Gneiting and Raftery 2007)
    many = rng.normal(size=(4000, 50))
    expected = (np.sqrt(2) - 1) / np.sqrt(np.pi)
    assert crps(many, np.zeros(50)) == pytest.approx(expected, rel=0.02)
    assert crps(draws[:1], truth) == pytest.approx(np.abs(draws[0] - truth).mean())


def test_coverage_and_variance_of_draws_from_the_truth():
    rng = numpy_rng(3)
    for count in (3, 9, 19):
        held = coverage(3 * rng.normal(size=(count, 20000)), 3 * rng.normal(size=20000))
        for nominal in (0.5, 0.8, 0.95):
            assert held[f"{nominal:.0%}"] == pytest.approx(nominal, abs=0.015)
    assert sample_variance(3 * rng.normal(size=(5, 20000))) == pytest.approx(9, rel=0.03)
    with pytest.raises(ValueError):
        sample_variance(np.zeros((1, 4)))


@pytest.mark.parametrize("common", [0.0, 0.5, 3.0])
def test_intervals_that_know_of_a_common_error_hold_what_they_say(common):
    """Draws about the truth of deviation 1, all of them off by the same normal error; without the
    common error counted they hold too little.
    """
    rng = numpy_rng(5)
    shared = common * rng.normal(size=40_000)
    draws = rng.normal(size=(6, 40_000)) + shared
    truth = rng.normal(size=40_000)
    held = held_within(draws, truth, common)
    for nominal in (0.5, 0.8, 0.95):
        assert held[f"{nominal:.0%}"] == pytest.approx(nominal, abs=0.03)
    if common == 3:
        assert held_within(draws, truth, 0)["80%"] < 0.6
    assert held_within(draws, truth, common, draws.mean(0)) == held
    assert held_within(draws, truth, common, draws.mean(0) + 100)["95%"] == 0
