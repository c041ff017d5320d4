"""The base colour from given shading: robust means, and how sharp they may be."""

from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest

from pipeline.posterior.base_color import USUAL, ColorSolver, shared_between_photos, weighed
from pipeline.posterior.color_choices import (
    CHOICES,
    CLEAR_GAIN,
    brighter_light,
    color_map,
    counted_best,
    error_by_other_views,
    lowest,
    sharpest_that_holds,
    solver_for,
    squared_srgb_error,
)
from pipeline.posterior.map_pixels import MapPixels
from pipeline.posterior.map_pyramid import TexelSums, coarse_to_fine
from pipeline.posterior.problem import SHADE
from pipeline.posterior.refine import as_the_mesh_shows
from pipeline.posterior.shading import Shading
from pipeline.posterior.textures import bilinear_matrix, gather, seen_texels, splat
from pipeline.render.renderer import Explanation
from tests.seeds import numpy_rng

SIZE = 64
VIEWS = 10


def pixels_of(truth: np.ndarray, count: int, misplaced: float = 0.0) -> tuple:
    """Observations of a flat map (t, t, 3) under shading that differs from pixel to pixel, whose uv
    are wrong by `misplaced` texels (standard deviation), all of a view by the same.
    """
    rng = numpy_rng(1)
    uv = rng.uniform(0.05, 0.95, (count, 2))
    view = rng.integers(VIEWS, size=count)
    shading = shading_of(rng.uniform(0.5, 2, (count, 3)), np.full((count, 3), 0.05))
    off = rng.normal(size=(VIEWS, 2))[view] * misplaced / SIZE
    observations = SimpleNamespace(
        uv=uv,
        view=view,
        cosine=rng.uniform(0.4, 1, count).astype(np.float32),
        rgb=(gather(truth, uv + off) * shading.scaled + shading.rest).astype(np.float32),
        clipped=np.zeros((count, 3), bool),
    )
    return observations, shading


def shading_of(scaled, rest, metallic: float = 0) -> Shading:
    """Of one metallic everywhere."""
    return Shading(scaled, rest, np.full((len(scaled), 1), metallic, np.float32))


def solver_of(observations, shading: Shading, begin: np.ndarray) -> ColorSolver:
    return solver_for(MapPixels(observations, SIZE), shading, begin)


@pytest.fixture(scope="module")
def truth() -> np.ndarray:
    """A map of detail in every second texel."""
    image = numpy_rng(0).uniform(0.1, 0.8, (SIZE // 2, SIZE // 2, 3))
    return np.repeat(np.repeat(image, 2, 0), 2, 1).astype(np.float32)


def test_bilinear_matrix_is_gather_and_its_transpose_splat(truth):
    rng = numpy_rng(0)
    uv = rng.uniform(0.02, 0.98, (300, 2))
    values = rng.random((300, 3))
    matrix = bilinear_matrix(uv, SIZE)
    assert np.allclose(matrix @ truth.reshape(-1, 3), gather(truth, uv), atol=0.01)
    summed = (matrix.T @ values).reshape(SIZE, SIZE, 3)
    assert np.allclose(summed, splat(uv, values, SIZE), atol=1e-5)


def test_texels_without_pixels_take_the_colour_around_them():
    pixels = np.zeros((SIZE, SIZE, 1), np.float32)
    pixels[:, :32] = 9
    shading = np.repeat(2 * pixels, 3, 2)
    color = coarse_to_fine(TexelSums(0.3 * shading, shading, pixels), 2.0)
    assert np.allclose(color, 0.3, atol=1e-4)


def test_a_brighter_lights_colours_are_those_of_brighter_shading(truth):
    observations, shading = pixels_of(truth, 4000)
    solver = solver_of(observations, shading, truth)
    bright = shading_of(1.5 * shading.scaled, 1.5 * shading.rest)
    alone = solver_of(observations, bright, truth)
    assert np.array_equal(solver.under(1.5).robust()[0], alone.robust()[0])
    assert solver.under(1) is solver


def test_pixels_on_a_map_are_its_matrix(truth):
    """To pixels and back, how many a texel has, and which texels are seen."""
    observations, _ = pixels_of(truth, 3000)
    pixels = MapPixels(observations, SIZE)
    assert np.allclose(pixels.of(truth), gather(truth, observations.uv), atol=0.01)
    ones = np.ones((3000, 1), np.float32)
    assert np.allclose(pixels.onto(ones), splat(observations.uv, ones, SIZE), atol=1e-4)
    assert np.allclose(pixels.count, pixels.onto(ones))
    assert (pixels.seen == seen_texels(observations.uv, SIZE)).all()


def test_one_pixels_highlight_leaves_no_dot():
    pixels = np.full((SIZE, SIZE, 1), 3, np.float32)
    shading = np.repeat(pixels, 3, 2)
    sums = 0.2 * shading
    sums[20, 20] += 2.4  # one of its pixels shows 1 where the others show .2
    plain = coarse_to_fine(TexelSums(sums, shading, pixels), 0.0)[20, 20]
    calmed = coarse_to_fine(TexelSums(sums, shading, pixels), 2.0)[20, 20]
    assert (plain > 0.9).all() and (calmed < 0.2 + 0.65 * (plain - 0.2)).all()


def weighed_by(picture, photo, known: float, contradiction: float = np.inf):
    return weighed(picture, photo, np.full(len(photo), known, np.float32), contradiction)


def test_weighted_error_is_that_of_the_log():
    """Of the first solve as it is; later by how large it is in the mean over a pixel's channels."""
    picture = np.array([[0.02, 0.5, 3.0], [-0.01, 0.2, 0.2]], np.float32)
    photo = np.array([[1.0, 0.5001, 0.1], [0.3, 0.2, 0.25]], np.float32)
    floored = np.maximum(picture, 0) + SHADE
    difference = np.log((photo + SHADE) / floored)
    slope = difference / np.where(photo == picture, 1, photo - np.maximum(picture, 0))
    expected = np.where(photo == picture, 1 / floored, slope) / floored

    weight, loss = weighed_by(picture, photo, 0.7)
    assert np.allclose(weight, 0.7 * expected, rtol=1e-3)
    assert np.isclose(loss, (((photo - picture) / (photo + SHADE)) ** 2).mean(), rtol=1e-5)
    trust = 1 / (1 + (np.abs(difference).mean(1, keepdims=True) / 0.5) ** 2)
    assert np.allclose(weighed_by(picture, photo, 0.7, 0.5)[0], trust * weight, rtol=1e-4)


def blob_under_lamps(color: float, known: float) -> ColorSolver:
    """A metal that mirrors lamps over a dim room, of which the solver's light knows a share: the
    rest is spread evenly.
    """
    flat = np.full((SIZE, SIZE, 3), color, np.float32)
    observations, _ = pixels_of(flat, 40_000)
    shape = (len(observations.uv), 1)
    mirrored = 0.2 * numpy_rng(4).lognormal(0, 1.5, shape) * np.ones(3, np.float32)
    observations.rgb = (color * mirrored).astype(np.float32)
    smooth = (known * mirrored + (1 - known) * mirrored.mean()).astype(np.float32)
    shading = shading_of(smooth, np.zeros_like(smooth), metallic=1)
    return solver_of(observations, shading, flat)


def counted(solver: ColorSolver, even: bool) -> ColorSolver:
    return ColorSolver(solver.pixels, solver.shading, solver.begin, even)


def test_a_metal_is_as_bright_as_the_photos_under_a_light_that_is_too_smooth():
    """By logs the dark counts most, where there is too much light, and the colour comes out too
    dark.
    """
    solver = blob_under_lamps(0.6, known=0.5)
    found = lambda even: float(np.median(counted(solver, even).robust()[0]))
    assert abs(found(True) / 0.6 - 1) < 0.15 < 0.25 < 1 - found(False) / 0.6


def test_a_metals_pixels_count_by_what_predicts_photos_better():
    """Either way of the map in the end, and each as sharp as suits it."""
    solver = blob_under_lamps(0.6, known=0.9)

    def error(even: bool) -> float:
        one = counted(solver, even)
        return error_by_other_views(one, sharpest_that_holds(one))

    chosen, sharpness = counted_best(solver, None)
    assert error_by_other_views(chosen, sharpness) == min(error(False), error(True))
    color, facts = color_map(solver)
    assert facts["around"] == sharpness.around
    assert np.array_equal(color, color_map(counted(solver, chosen.even), sharpness)[0])


def test_no_other_pixels_are_weighed_anew():
    """On a dielectric beside metal weights are the log's; on the metal they are of its place."""
    truth = np.full((SIZE, SIZE, 3), 0.4, np.float32)
    observations, shading = pixels_of(truth, 20_000)
    metallic = (observations.uv[:, :1] > 0.5).astype(np.float32)
    solver = solver_of(observations, Shading(shading.scaled, shading.rest, metallic), truth)
    photo = solver.photo(solver.picture(truth))
    by_log, _ = weighed(solver.picture(truth), photo, np.ones(len(photo), np.float32))
    metal, even = metallic[:, 0] == 1, solver.evened(by_log) * by_log
    assert np.array_equal(even[~metal], by_log[~metal])
    near = np.abs(observations.uv[metal] - 0.75).max(1) < 0.05
    assert even[metal][near].std() < 0.5 * by_log[metal][near].std()
    assert abs(even[metal].mean() / by_log[metal].mean() - 1) < 0.1


def test_what_photos_show_beyond_a_picture(truth):
    observations, shading = pixels_of(truth, 3000)
    pixels, weight = MapPixels(observations, SIZE), numpy_rng(2).random((3000, 3))
    color, (scaled, rest) = 0.5 * truth, (shading.scaled, shading.rest)
    found = pixels.left_over(color, scaled, rest, observations.rgb, weight)
    picture = pixels.of(color) * scaled + rest
    expected = pixels.onto(weight * (observations.rgb - picture))
    assert np.allclose(found, expected, atol=1e-4)


def test_map_is_as_sharp_as_the_cameras_allow(truth):
    begin = np.full((SIZE, SIZE, 3), 0.4, np.float32)
    inside = np.s_[6:-6, 6:-6]
    chosen = {}
    for misplaced in (0.0, 2.0):
        observations, shading = pixels_of(truth, 40000, misplaced)
        solver = solver_of(observations, shading, begin)
        color, chosen[misplaced] = color_map(solver)
        mean, _, loss = solver.robust()
        assert chosen[misplaced]["loss"] == loss
        if not misplaced:
            error = lambda image: np.abs(image - truth)[inside].mean()
            assert error(color) < 0.5 * error(mean)
    assert chosen[0.0]["passes"] == max(choice.passes for choice in CHOICES)
    assert chosen[2.0]["passes"] == 0


def test_map_is_smooth_where_what_is_mirrored_is_wrong():
    """One colour all over. What every view's texels mirror is off by another factor each."""
    plain = np.full((SIZE, SIZE, 3), 0.4, np.float32)
    observations, shading = pixels_of(plain, 40000)
    wrong = np.exp(0.3 * numpy_rng(2).normal(size=(VIEWS, SIZE, SIZE, 1))).repeat(3, -1)
    for view in range(VIEWS):
        of_view = observations.view == view
        shading.scaled[of_view] *= gather(wrong[view], observations.uv[of_view])
    solver = solver_of(observations, shading, plain)
    color, chosen = color_map(solver)
    usual, _, _ = solver.robust()
    assert chosen["around"] > 4
    inside = np.s_[6:-6, 6:-6]
    assert color[inside].std() < 0.5 * usual[inside].std()


def test_the_lowest_error_is_found_from_anywhere_and_each_is_asked_for_once():
    rng = numpy_rng(0)
    for count in range(1, 8):
        for least in range(count):
            steps = rng.uniform(0.1, 1, count)
            errors = [float(steps[min(k, least) : max(k, least)].sum()) for k in range(count)]
            for start in range(count):
                error = Mock(side_effect=errors.__getitem__)
                assert lowest(error, start, count) == least
                assert error.call_count == len({call.args for call in error.mock_calls})


def test_views_that_contradict_the_others_are_forgotten(truth):
    observations, shading = pixels_of(truth, 40000)
    observations.rgb[observations.view == 3] += 4.0
    begin = np.full((SIZE, SIZE, 3), 0.4, np.float32)
    color, _ = color_map(solver_of(observations, shading, begin))
    assert np.abs(color - truth)[6:-6, 6:-6].mean() < 0.05


def test_pixels_that_are_unseen_say_nothing(truth):
    """Photos that judge a map have no part in it, nor in which pixels of others are trusted."""
    observations, shading = pixels_of(truth, 40000)
    begin = np.full((SIZE, SIZE, 3), 0.4, np.float32)
    judge = observations.view % 5 == 0
    color, weight, _ = solver_of(observations, shading, begin).robust(judge)
    assert (weight[judge] == 0).all() and (weight[~judge] > 0).all()

    observations.rgb[judge] *= 3
    again, _, _ = solver_of(observations, shading, begin).robust(judge)
    assert np.array_equal(color, again)


def test_what_a_third_of_the_photos_says_counts():
    """A third of the pixels is twice as bright: the colour is nearer to the mean of logs (1.26)
    than to what most say. A width of a quarter of the error forgot them (1.11).
    """
    truth = np.full((SIZE, SIZE, 3), 0.3, np.float32)
    observations, shading = pixels_of(truth, 40000)
    third = numpy_rng(2).random(40000) < 1 / 3
    observations.rgb[third] *= 2
    color, _, _ = solver_of(observations, shading, truth).robust()
    more = color[6:-6, 6:-6].mean() / 0.3
    assert 1.2 < more < 1.35


def test_saturated_pixels_do_not_pull_the_colour_down():
    truth = np.full((SIZE, SIZE, 3), 0.5, np.float32)
    observations, shading = pixels_of(truth, 40000)
    observations.clipped = observations.rgb > 0.6
    observations.rgb = np.minimum(observations.rgb, 0.6)
    assert observations.clipped.mean() > 0.5
    color, facts = color_map(solver_of(observations, shading, truth))
    assert facts["loss"] < 1e-6
    assert np.abs(color - truth).max() < 0.01

    observations.clipped[:] = False
    color, _ = color_map(solver_of(observations, shading, truth))
    assert color[6:-6, 6:-6].mean() < 0.45


def test_channels_that_are_not_saturated_say_all_they_know():
    """Yellow, red saturated nearly everywhere: green and blue are right from a bright start."""
    truth = np.full((SIZE, SIZE, 3), [0.9, 0.5, 0.1], np.float32)
    observations, shading = pixels_of(truth, 40000)
    observations.clipped = observations.rgb > [0.5, 9, 9]
    observations.rgb = np.minimum(observations.rgb, [0.5, 9, 9]).astype(np.float32)
    color, _ = color_map(solver_of(observations, shading, np.full_like(truth, 0.98)))
    assert np.abs(color - truth)[6:-6, 6:-6, 1:].max() < 0.01


@pytest.mark.parametrize("times, found", [(1.0, 1.0), (1.75, 1.75)])
def test_light_is_as_bright_as_colours_below_one_need(truth, times, found):
    """A light that is `times` too dim needs colours up to 1.6, few of them above 1.42: it is raised
    until none are at the limit; a right one stays.
    """
    observations, shading = pixels_of(np.clip(1.15 * truth, 0, 0.92), 40_000)
    dim = shading.under(1 / times)
    begin = np.full((SIZE, SIZE, 3), 0.4, np.float32)
    assert brighter_light(solver_of(observations, dim, begin)) == found


def test_a_small_part_at_the_limit_raises_the_light():
    """Three pixels of a hundred need a colour of 1.6 under this light."""
    truth = np.full((SIZE, SIZE, 3), 0.3, np.float32)
    truth[24:34, 24:34] = 0.92
    observations, shading = pixels_of(truth, 40_000)
    dim = shading.under(1 / 1.75)
    assert brighter_light(solver_of(observations, dim, truth)) >= 1.45
    assert brighter_light(solver_of(observations, shading, truth)) == 1


@pytest.mark.parametrize("side, metallic, found", [(8, 0, 1.0), (16, 0, 1.2), (16, 1, 1.0)])
def test_many_matt_colours_at_the_limit_raise_the_light_by_themselves(truth, side, metallic, found):
    """A square needs colours of 1.03, which costs next to nothing beside the photos' noise: where
    it is a sixtieth of the map the light stays, where it is a sixteenth it is raised; a metal may
    be gold.
    """
    white = 0.5 * truth
    white[24 : 24 + side, 24 : 24 + side] = 0.9
    observations, shading = pixels_of(white, 40_000)
    shading = shading_of(shading.scaled, shading.rest, metallic)
    observations.rgb *= numpy_rng(6).uniform(0.8, 1.2, (40_000, 1)).astype(np.float32)
    dim = solver_of(observations, shading.under(1 / 1.15), white)
    errors = [error_by_other_views(dim.under(factor), USUAL) for factor in (1.0, 1.2)]
    assert errors[0] / errors[1] == pytest.approx(1, abs=CLEAR_GAIN)
    assert brighter_light(dim) == found


def test_light_is_raised_for_colours_at_the_limit_only():
    """A tenth of the map needs a colour of 1.06, below 1 under a light brighter by a fifth.
    Twice the light would explain more, for highlights are half of what they are: no reason here.
    """
    truth = np.full((SIZE, SIZE, 3), 0.3, np.float32)
    truth[20:36, 20:36] = 0.92
    observations, shading = pixels_of(truth, 40_000)
    highlights = numpy_rng(5).uniform(0, 0.2, (len(shading.rest), 1))
    observations.rgb += (highlights - shading.rest).astype(np.float32)
    dull = shading_of(shading.scaled / 1.15, np.repeat(0.5 * highlights, 3, 1))

    def error(factor):
        solver = solver_of(observations, dull, truth).under(factor)
        color = solver.robust()[0]
        return squared_srgb_error(solver.picture(color), observations.rgb)

    assert error(1.75) < (1 - CLEAR_GAIN) * error(1.2) < (1 - CLEAR_GAIN) ** 2 * error(1.0)
    assert brighter_light(solver_of(observations, dull, truth)) == 1.2


def test_shading_of_a_dielectric_is_shared_between_photos_and_of_a_metal_is_not(truth):
    """D that follows the surface, with the noise of each photo's own paths."""
    observations, _ = pixels_of(truth, 60_000)
    rng = numpy_rng(2)
    smooth = 1 + 0.3 * np.sin(4 * observations.uv[:, :1]) * np.ones(3)
    noisy = smooth * rng.lognormal(0, 0.2, smooth.shape)
    metallic = (observations.uv[:, :1] > 0.5).astype(np.float32)
    rest = np.full(smooth.shape, 0.05, np.float32)
    shading = Shading(noisy.astype(np.float32), rest, metallic)
    shared = shared_between_photos(MapPixels(observations, SIZE), shading)
    metal = metallic[:, 0] > 0
    error = lambda values: np.abs(values / smooth - 1)[~metal].mean()
    assert error(shared.scaled) < 0.35 * error(noisy)
    assert np.allclose(shared.scaled[metal], noisy[metal], rtol=1e-5)
    assert (shared.rest == shading.rest).all()


def test_refinement_begins_with_what_the_mesh_shows():
    """On the true surface a draw's gloss stays; normals off by .1 per axis make a sharp lobe one of
    alpha^2 = .1^4 + 2 .01.
    """
    shape = (4, 4)
    ones = np.ones(shape, np.float32)
    draw = Explanation(np.ones((4, 8, 3)), np.ones((*shape, 3)), 0.1 * ones, 0 * ones)
    assert np.allclose(as_the_mesh_shows(draw, 0.0).roughness, 0.1)
    shown = as_the_mesh_shows(draw, 0.1 * np.sqrt(2 * np.log(2))).roughness
    assert np.allclose(shown**4, 0.1**4 + 2 * 0.1**2, rtol=1e-3)
