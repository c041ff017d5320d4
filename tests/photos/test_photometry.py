"""Brightness and white balance from matched points."""

import tracemalloc

import numpy as np
import pytest

from pipeline.base.config import Poses
from pipeline.base.images import read_exr, write_exr
from pipeline.photos.photometry import (
    erratic,
    gains,
    match_exposure,
    point_brightness,
    spread,
    worth_dividing,
)
from pipeline.photos.poses import _photometry
from pipeline.photos.readings import Readings
from pipeline.photos.turntable import light_motion
from tests.seeds import numpy_rng

STOPS = np.array(
    [
        [-0.9, -0.8, -0.5],
        [0.5, 0.5, 0.9],
        [0.0, 0.1, -0.6],
        [0.3, 0.4, 0.4],
        [-0.2, -0.2, 0.3],
        [0.9, 0.6, -0.4],
        [1.0, -0.6, -1.0],
    ]
)


def seen(stops, rng, points=400):
    """log2 radiance (views, points, 3) of points under known gains, with shading that changes with
    the view; a third seen per photo.
    """
    value = rng.uniform(-3, 0, (points, 3)) + stops[:, None]
    value = value + 0.1 * rng.normal(size=value.shape)
    return np.where((rng.random(value.shape[:2]) < 0.35)[..., None], value, np.nan)


def test_gains_are_found_and_sum_to_zero_in_every_channel():
    found = gains(seen(STOPS, numpy_rng(0)))
    np.testing.assert_allclose(found, STOPS - STOPS.mean(0), atol=0.06)
    np.testing.assert_allclose(found.sum(0), 0, atol=1e-12)


def test_highlights_do_not_move_gains():
    """A tenth of all sightings three stops brighter: least squares would be off by .3."""
    rng = numpy_rng(1)
    values = seen(STOPS, rng)
    values[:3] += 3.0 * (rng.random(values[:3].shape[:2]) < 0.1)[..., None]
    np.testing.assert_allclose(gains(values), STOPS - STOPS.mean(0), atol=0.08)


def test_photos_without_links_keep_their_exposure_and_the_rest_sums_to_zero():
    rows = seen(STOPS, numpy_rng(2))
    rows[1, 20:] = np.nan  # too few points
    rows[2, :300] = np.nan  # ... and one that shares its points with no other
    rows[[0, 1, 3, 4, 5, 6], 300:] = np.nan
    found = gains(rows)
    rest = [0, 3, 4, 5, 6]
    assert (found[[1, 2]] == 0).all()
    np.testing.assert_allclose(found[rest], STOPS[rest] - STOPS[rest].mean(0), atol=0.08)
    np.testing.assert_allclose(found.sum(0), 0, atol=1e-12)


def test_brightness_and_white_balance_are_divided_each_for_itself():
    level = np.array([-1.0, 1.0, 0.5, -0.5])[:, None] * np.ones(3)
    tint = np.array([1.0, -1.0, -1.0, 1.0])[:, None] * np.array([0.3, 0.0, -0.3])
    np.testing.assert_allclose(worth_dividing(level + 0.1 * tint)[0], level, atol=1e-12)
    np.testing.assert_allclose(worth_dividing(0.1 * level + tint)[0], tint, atol=1e-12)
    np.testing.assert_allclose(worth_dividing(level + tint)[0], level + tint, atol=1e-12)


@pytest.mark.parametrize("known", [True, False])
def test_shading_all_the_way_round_is_no_exposure_where_exposures_are_known(known):
    """Gains of 1.4 stops either way that follow the azimuth, as a lit metal's, in photos in any
    order; and the same gains handed out at random, which are exposures whatever EXIF says.
    """
    rng = numpy_rng(3)
    azimuth = rng.permutation(np.linspace(0, 2 * np.pi, 40, endpoint=False))
    directions = np.stack([np.cos(azimuth), 0 * azimuth, np.sin(azimuth)], 1)
    drifting = np.repeat(1.4 * np.cos(azimuth)[:, None], 3, 1)
    for stops, matched in ((drifting, not known), (rng.permutation(drifting), True)):
        divided, facts = worth_dividing(stops, None, directions if known else None)
        assert facts["exposure_matched"] == matched
        np.testing.assert_allclose(divided, stops * matched, atol=1e-12)


@pytest.mark.parametrize("known", [True, False])
def test_photos_of_known_exposure_keep_their_brightness(ring, tmp_path, known):
    """Through the stage: forty photos that darken by two stops as the camera goes to the back."""
    views = ring(40, 64)
    (tmp_path / "images").mkdir()
    for v in views:
        side = v.position[0] / np.linalg.norm(v.position)
        write_exr(tmp_path / v.image, np.full((64, 64, 3), 0.2 * 2**side))
    xyz = numpy_rng(0).uniform(-0.3, 0.3, (200, 3))
    seen_by = np.tile(np.arange(40), 200)
    points = {"xyz": xyz, "offsets": np.arange(0, 8001, 40), "views": seen_by}
    sphere = np.zeros(3), 1.0
    captured = {"exposure_known": known}
    _, facts = _photometry(views, tmp_path, points, sphere, tmp_path, Poses(), captured)
    assert facts["exposure_matched"] == (not known)
    left = np.ptp([np.log2(read_exr(tmp_path / v.image).mean()) for v in views])
    assert left > 1.5 if known else left < 0.1


def test_sessions_in_another_daylight_are_matched_though_exposures_are_known():
    """Two rounds of twenty photos, a stop apart, around a thing that is lit from one side."""
    azimuth = np.tile(np.linspace(0, 2 * np.pi, 20, endpoint=False), 2)
    azimuth[20:] += 0.05
    directions = np.stack([np.cos(azimuth), 0 * azimuth, np.sin(azimuth)], 1)
    level = 0.4 * np.cos(azimuth) + np.repeat([-0.5, 0.5], 20)
    stops = np.repeat(level[:, None], 3, 1)
    divided, facts = worth_dividing(stops, None, directions)
    assert facts["exposure_matched"]
    np.testing.assert_allclose(divided, stops, atol=1e-12)


def test_a_photos_own_error_is_found_in_its_size():
    """Beside a drift; errors of deviation .5, by many photos."""
    rng = numpy_rng(4)
    azimuth = np.linspace(0, 2 * np.pi, 4000, endpoint=False)
    directions = np.stack([np.cos(azimuth), 0 * azimuth, np.sin(azimuth)], 1)
    level = 2 * np.cos(azimuth) + 0.5 * rng.normal(size=len(azimuth))
    assert spread(erratic(level, directions)) == pytest.approx(0.5, rel=0.06)


@pytest.mark.parametrize("step,matched", [(0.8, True), (0.02, False)])
def test_photos_are_divided_only_if_it_is_much(ring, tmp_path, step, matched):
    rng, views = numpy_rng(0), ring(6, 64)
    (tmp_path / "images").mkdir()
    stops = step * (np.array([-1, 0, 1, 1, -1, 0.5])[:, None] + np.array([0.5, 0, -0.5]))
    stops[0] += step * np.array([1.0, 0, -1])
    for v, s in zip(views, stops):
        write_exr(tmp_path / v.image, np.ones((64, 64, 1)) * 0.2 * 2**s)
    xyz = rng.uniform(-0.3, 0.3, (200, 3))
    points = {"xyz": xyz, "offsets": np.arange(0, 1201, 6), "views": np.tile(np.arange(6), 200)}

    found = gains(point_brightness(views, tmp_path, points))
    new, facts = match_exposure(views, tmp_path, found)
    brightness = np.array([read_exr(tmp_path / v.image).mean((0, 1)) for v in views])
    assert facts["exposure_matched"] == matched
    assert bool(np.ptp(np.log2(brightness.mean(1))) < 0.35 * step) == matched
    before = np.exp2(np.log2(0.2) + stops.mean(0))  # geometric mean of the set, per channel
    np.testing.assert_allclose(np.exp(np.log(brightness).mean(0)), before, rtol=2e-3)


def test_saturated_sightings_do_not_count(ring, tmp_path):
    """By the picture of saturated pixels, not by their value: their mean may lie anywhere."""
    from dataclasses import replace

    from pipeline.base.images import write_png

    view = replace(ring(6, 64)[0], saturated="saturated/v0.png")
    write_exr(tmp_path / view.image, np.full((64, 64, 3), 0.5))
    left = np.zeros((64, 64, 3), np.uint8)
    left[:, :32] = 255
    write_png(tmp_path / "saturated" / "v0.png", left)
    xyz = numpy_rng(0).uniform(-0.3, 0.3, (100, 3))
    points = {"xyz": xyz, "offsets": np.arange(101), "views": np.zeros(100, int)}
    found = point_brightness([view], tmp_path, points).value
    clipped = view.project(xyz)[0][:, 0] < 32
    assert np.isnan(found[clipped]).all() and np.allclose(found[~clipped], -1)
    assert 10 < clipped.sum() < 90


def test_readings_are_the_table_without_its_gaps():
    table = np.where(numpy_rng(0).random((5, 9)) < 0.4, numpy_rng(1).normal(size=(5, 9)), np.nan)
    found = Readings.of(table)
    np.testing.assert_array_equal(found.sum_of_points(found.value), np.nansum(table, 0))
    np.testing.assert_allclose(found.sum_of_views(found.value), np.nansum(table, 1))

    views = np.array([True, False, True, True, False])
    points = np.isfinite(table[views]).sum(0) >= 1
    some = found.of_views(views).of_points(points)
    again = np.full((some.views, some.points), np.nan)
    again[some.view, some.point] = some.value
    np.testing.assert_array_equal(again, table[views][:, points])
    stops = numpy_rng(2).normal(size=5)
    np.testing.assert_array_equal(
        found.less(stops).value, Readings.of(table - stops[:, None]).value
    )


def test_memory_is_that_of_the_matches_not_of_views_times_points(ring, tmp_path):
    """Every point is seen by three of forty photos, as points of a walk around an object are."""
    views = ring(40, 64)
    count = 40_000
    picture = numpy_rng(0).uniform(0.1, 0.9, (64, 64, 3)).astype(np.float32)
    for v in views:
        write_exr(tmp_path / v.image, picture)
    first = numpy_rng(1).integers(0, len(views) - 2, count)
    points = {
        "xyz": numpy_rng(2).uniform(-0.3, 0.3, (count, 3)),
        "offsets": np.arange(0, 3 * count + 1, 3),
        "views": (first[:, None] + np.arange(3)).ravel(),
    }

    tracemalloc.start()
    brightness = point_brightness(views, tmp_path, points)
    stops = gains(brightness)
    green = brightness.channel(1).less(stops[:, 1])
    light_motion(views, green, points["xyz"], np.zeros(3), 0.5)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 2 * 8 * len(views) * count  # two tables of one channel
