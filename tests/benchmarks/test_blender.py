"""Blender's cameras see what the photos' do; a Blender that fails is told."""

import sys

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from benchmarks.blender import Z_UP, camera_of, compared, pictures
from pipeline.base.errors import InputError
from pipeline.geometry.cameras import View
from tests.seeds import numpy_rng


@pytest.mark.parametrize("fy", [470.0, 500.0, 560.0])
def test_a_point_is_where_the_photo_has_it(fy):
    """By the manual's camera: lens over sensor in widths of the picture, shifts taken off, pixels
    as high as their aspect says.
    """
    rng = numpy_rng(0)
    to_camera = np.eye(4)
    to_camera[:3, :3] = Rotation.from_rotvec([0.4, -1.1, 0.7]).as_matrix()
    to_camera[:3, 3] = [0.1, -0.2, 3]
    view = View("a", "a.png", 640, 400, 500.0, fy, 300.0, 220.0, to_camera)
    point = rng.normal(size=(50, 3)) * 0.5
    expected, _ = view.project(point)

    c = camera_of(view)
    at = np.linalg.inv(c["matrix"]) @ Z_UP @ np.concatenate([point, np.ones((50, 1))], 1).T
    across, up = c["lens"] / c["sensor"] * at[:2] / -at[2] - np.array(c["shift"])[:, None]
    width, height = c["size"]
    wide, high = c["aspect"]
    found = [width * (0.5 + across), height / 2 - width * wide / high * up]
    np.testing.assert_allclose(np.stack(found, 1), expected, atol=1e-6)
    assert min(c["aspect"]) == 1


def test_score_and_level_are_of_the_chosen_pixels():
    rng = numpy_rng(1)
    photo = rng.uniform(0.1, 0.5, (8, 8, 3)).astype(np.float32)
    mask = np.arange(64).reshape(8, 8) % 3 == 0
    brighter = np.where(mask[..., None], 1.1 * photo, 9).astype(np.float32)
    found = compared([np.stack([brighter, brighter])], [(None, photo, mask)], [mask])
    assert abs(found["level"] - 1.1) < 1e-5 and 20 < found["psnr"] < 40


def test_a_blender_that_fails_is_told(tmp_path):
    with pytest.raises(InputError, match="bpy"):
        pictures(sys.executable, tmp_path / "none.usda", [])
