"""Photos whose contrast is brought out for matching."""

import cv2
import numpy as np
import pytest

from pipeline.base.images import to_srgb8
from pipeline.photos.contrast import brought_out
from tests.photos.test_structure import texture


def features(grey: np.ndarray) -> int:
    return len(cv2.SIFT_create().detect(grey))


def plain(photo: np.ndarray) -> np.ndarray:
    return cv2.cvtColor(photo, cv2.COLOR_RGB2GRAY)


@pytest.mark.parametrize("seed", range(3))
def test_a_photo_in_the_dark_has_features(seed):
    dark = to_srgb8(0.02 * texture(seed, 512))
    assert features(plain(dark)) < 20
    assert features(brought_out(dark)) > 200


def test_half_a_photo_in_shadow_has_features_there():
    photo = texture(3, 512)
    photo[:, :256] *= 0.02
    photo = to_srgb8(photo)
    assert features(plain(photo)[:, :240]) < 20
    assert features(brought_out(photo)[:, :240]) > 100


def test_it_is_grey_and_of_the_photos_size():
    found = brought_out(to_srgb8(texture(4, 64))[:40])
    assert found.shape == (40, 64) and found.dtype == np.uint8
