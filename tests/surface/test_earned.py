"""Where the hull stands in for depth that did not earn its place."""

from dataclasses import replace

import numpy as np
import pytest

from pipeline.surface.earned import LITTLE_WRONG, MUCH_WRONG, WORTH_AROUND, asked, divided
from tests.conftest import sphere


def test_nothing_is_asked_of_depth_that_masks_find_right():
    assert asked(0) == asked(LITTLE_WRONG) == 0
    assert asked(MUCH_WRONG) == asked(1) == pytest.approx(WORTH_AROUND)
    assert 0 < asked(0.5 * (LITTLE_WRONG + MUCH_WRONG)) < WORTH_AROUND


def test_points_are_divided_by_what_depth_saves_around_them():
    """It saves .3 in front and .1 behind."""
    hull = sphere(3)
    fused = replace(hull, vertices=0.8 * hull.vertices)
    share = lambda points: np.where(points[:, 0] > 0, 0.3, 0.1)
    earned, rest = divided(fused, hull, share, 0.2)
    np.testing.assert_array_equal(earned, fused.vertices[:, 0] > 0)
    behind = hull.vertices[:, 0] <= 0
    np.testing.assert_array_equal(rest.vertices, hull.vertices[behind])
    np.testing.assert_array_equal(rest.normals, hull.normals[behind])

    earned, rest = divided(fused, hull, share, 0.05)
    assert earned.all() and not len(rest.vertices)
