"""What the bare ground looks like, and in which colours."""

import tracemalloc

import cv2
import numpy as np
import pytest

from pipeline.base.images import linear_to_srgb
from pipeline.geometry.cameras import Rig
from pipeline.masks import ground
from pipeline.masks.ground import TEXTURE, bare_ground, lab_of
from tests.seeds import numpy_rng


@pytest.mark.slow
def test_the_bare_ground_is_the_same_in_parts_and_needs_no_stack_of_all_views(ring, monkeypatch):
    """Memory does not grow by a texture of the ground with every photo."""
    rng = numpy_rng(0)
    views = ring(24, 40)
    rig = Rig(views, np.zeros(3), 0.4, "sfm")
    labs = {v.name: rng.random((40, 40, 3)).astype(np.float32) for v in views}
    covered = {v.name: rng.random((40, 40)) < 0.2 for v in views}

    tracemalloc.start()
    in_parts = bare_ground(rig, labs, -0.3, covered)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 0.5 * len(views) * TEXTURE**2 * 3 * 4

    monkeypatch.setattr(ground, "PART", TEXTURE**2)
    whole = bare_ground(rig, labs, -0.3, covered)
    assert np.isfinite(whole[1]).mean() > 0.2
    for a, b in zip(in_parts, whole):
        np.testing.assert_array_equal(a, b)


def test_lab_is_opencv_s_up_to_white():
    linear = numpy_rng(1).random((20, 30, 3)).astype(np.float32)
    own = cv2.cvtColor(linear_to_srgb(linear), cv2.COLOR_RGB2Lab)
    np.testing.assert_array_equal(lab_of(linear), own)


def exact_lab(linear):
    """By its definition, from CIE XYZ of D65 (n, 3), all beyond the curve's straight part."""
    to_xyz = np.array(
        [
            [0.412453, 0.357580, 0.180423],
            [0.212671, 0.715160, 0.072169],
            [0.019334, 0.119193, 0.950227],
        ]
    )
    x, y, z = np.cbrt(linear @ to_xyz.T / to_xyz.sum(1)).T
    return np.stack([116 * y - 16, 500 * (x - y), 200 * (y - z)], -1)


def test_lab_goes_on_above_white():
    linear = numpy_rng(2).uniform(0.3, 60, (40, 3)).astype(np.float32)
    over = np.maximum(linear.max(1, keepdims=True), 1)
    error = np.abs(lab_of((linear / over)[None])[0] - exact_lab(linear / over)).max()  # OpenCV's
    assert error < 1
    apart = np.abs(lab_of(linear[None])[0] - exact_lab(linear))
    assert (apart <= 1.01 * error * np.cbrt(over)).all()
