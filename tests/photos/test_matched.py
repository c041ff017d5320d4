"""Photos as features are sought in them."""

import cv2
import numpy as np
import pytest

from pipeline.base.images import to_srgb8
from pipeline.photos.matched import for_matching
from tests.photos.test_structure import texture


def features(grey: np.ndarray) -> int:
    return len(cv2.SIFT_create().detect(grey))


@pytest.mark.parametrize("seed", range(3))
def test_a_photo_in_the_dark_has_features(seed):
    dark = 0.02 * texture(seed, 512)
    as_exposed = cv2.cvtColor(to_srgb8(dark), cv2.COLOR_RGB2GRAY)
    assert features(as_exposed) < 20
    assert features(np.asarray(for_matching(dark, 512))) > 200


def test_half_a_photo_in_shadow_has_features_there():
    photo = texture(3, 512)
    photo[:, :256] *= 0.02
    as_exposed = cv2.cvtColor(to_srgb8(photo), cv2.COLOR_RGB2GRAY)
    assert features(as_exposed[:, :240]) < 20
    assert features(np.asarray(for_matching(photo, 512))[:, :240]) > 100


@pytest.mark.parametrize(("size", "small"), [((300, 200), (150, 100)), ((100, 150), (100, 150))])
def test_the_long_side_is_bounded_and_small_photos_stay(size, small):
    width, height = size
    photo = texture(4, 300)[:height, :width]
    image = for_matching(photo, 150)
    assert image.size == small
    assert image.mode == "L"
