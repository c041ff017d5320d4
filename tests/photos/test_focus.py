"""Photos out of focus: the width of an edge in closed form, and what capture says."""

import cv2
import numpy as np
import pytest
from PIL import Image

from pipeline.base.config import Capture
from pipeline.photos.capture import capture
from pipeline.photos.focus import WIDE, edge_width, said_of_focus
from tests.seeds import numpy_rng


def disc(side: int, blur: float, middle: float = 0.5) -> np.ndarray:
    """A bright disc before a dark, finely textured ground, out of focus by a Gaussian."""
    y, x = np.mgrid[:side, :side] / side - middle
    grey = 0.2 + 0.6 * (np.hypot(x, y) < 0.3)
    grey += 0.02 * numpy_rng(0).normal(size=grey.shape)
    return cv2.GaussianBlur(grey, (0, 0), blur) if blur else grey


@pytest.mark.parametrize("blur", [3.0, 6.0, 12.0])
def test_a_blurred_step_is_as_wide_as_its_gradient_says(blur):
    """A step of height 1 blurred by a Gaussian of width s has the slope 1 / (s sqrt(2 pi))."""
    expected = np.sqrt(2 * np.pi * (blur**2 + 0.7**2))
    assert edge_width(disc(600, blur)) == pytest.approx(expected, rel=0.15)


def test_something_in_focus_is_enough():
    """A sharp object before a soft ground: the steepest edges count."""
    soft = 0.5 + 0.5 * cv2.GaussianBlur(numpy_rng(1).normal(size=(600, 600)), (0, 0), 20)
    both = np.where(disc(600, 0) > 0.5, 0.9, soft)
    assert edge_width(both) < 0.3 * edge_width(soft)


def test_a_picture_without_edges_has_no_width():
    assert edge_width(np.full((50, 80), 0.3)) == np.inf
    assert said_of_focus([np.inf] * 5) == []


def test_the_median_photo_decides():
    assert said_of_focus([WIDE] * 5) == []
    assert said_of_focus([26.0] * 2 + [3.0] * 3) == []
    assert len(said_of_focus([26.0] * 3 + [3.0] * 2)) == 1


@pytest.mark.parametrize("blur, warned", [(0.0, False), (1.5, False), (8.0, True)])
def test_capture_warns_of_photos_out_of_focus(tmp_path, blur, warned):
    scene, out = tmp_path / "scene", tmp_path / "out"
    (scene / "images").mkdir(parents=True)
    out.mkdir()
    for k in range(5):
        grey = np.clip(disc(300, blur, 0.4 + 0.05 * k), 0, 1)
        picture = (255 * np.repeat(grey[..., None], 3, 2)).astype(np.uint8)
        Image.fromarray(picture).save(scene / "images" / f"{k}.png")
    said = capture(scene, out, Capture())["warnings"]
    assert any("out of focus" in text for text in said) == warned
