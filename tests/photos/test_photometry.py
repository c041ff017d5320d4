"""Exposure from matched points."""

import numpy as np
import pytest

from pipeline.base.images import read_exr, write_exr
from pipeline.photos.photometry import gains, match_exposure, spread


def seen(stops, rng, points=400):
    """log2 brightness of points under known gains, with shading that changes with the view; a third
    seen per photo.
    """
    value = (
        rng.uniform(-3, 0, points)
        + np.array(stops)[:, None]
        + 0.1 * rng.normal(size=(len(stops), points))
    )
    return np.where(rng.random(value.shape) < 0.35, value, np.nan)


def test_gains_are_found_up_to_their_median():
    stops = np.array([-0.8, 0.5, 0.0, 0.3, -0.2, 0.9, 0.0])
    found = gains(seen(stops, np.random.default_rng(0)))
    np.testing.assert_allclose(found, stops - np.median(stops), atol=0.06)
    assert spread(found) > 0.25


def test_a_photo_with_few_points_keeps_its_exposure():
    rows = seen(np.array([0.0, 1.0, 0.0, 0.0]), np.random.default_rng(1))
    rows[1, 20:] = np.nan
    assert gains(rows)[1] == 0


@pytest.mark.parametrize("step,matched", [(0.8, True), (0.02, False)])
def test_photos_are_divided_only_if_it_is_much(ring, tmp_path, step, matched):
    rng, views = np.random.default_rng(0), ring(6, 64)
    (tmp_path / "images").mkdir()
    stops = step * np.array([-1, 0, 1, 1, -1, 0.5])
    for v, s in zip(views, stops):
        write_exr(tmp_path / v.image, np.full((64, 64, 3), 0.2 * 2**s))
    xyz = rng.uniform(-0.3, 0.3, (200, 3))
    points = {"xyz": xyz, "offsets": np.arange(0, 1201, 6), "views": np.tile(np.arange(6), 200)}
    new, facts = match_exposure(views, tmp_path, points)
    brightness = np.array([read_exr(tmp_path / v.image).mean() for v in views])
    assert facts["exposure_matched"] == matched
    assert bool(np.ptp(np.log2(brightness)) < 0.01) == matched
    if matched:
        np.testing.assert_allclose(
            [n.clip_level * 2**s for n, s in zip(new, stops - np.median(stops))], 1.0, atol=1e-3
        )
