"""A free highlight is found where there is one, and is none where there is none."""

import numpy as np
import pytest

from benchmarks.view_dependence import Seen, even_directions, fitted, products
from tests.seeds import numpy_rng

PIXELS, PHOTOS = 30_000, 12
TEXELS = 16


def reflections(seed):
    """Pixels of photos whose reflected directions have nothing to do with where they are."""
    rng = numpy_rng(seed)
    direction = rng.normal(size=(PIXELS, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    uv = rng.random((PIXELS, 2)).astype(np.float32)
    cosine = rng.uniform(0.2, 1, PIXELS).astype(np.float32)
    photo = rng.integers(PHOTOS, size=PIXELS)
    return Seen(uv, direction.astype(np.float32), cosine), photo


def lobe(seen):
    """A warm highlight about one direction, wider than the model's Gaussians."""
    return np.exp(3 * (seen.reflected @ [0.6, 0, 0.8] - 1))[:, None] * [0.3, 0.2, 0.1]


def test_directions_lie_evenly():
    found = even_directions(128)
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1, atol=1e-5)
    np.testing.assert_allclose(found.mean(0), 0, atol=0.01)
    cosine = found @ found.T - 2 * np.eye(128)
    assert np.ptp(np.arccos(cosine.max(1))) < 0.15


def test_a_highlight_is_found():
    seen, photo = reflections(0)
    texture = 0.2 * np.sin(9 * seen.uv[:, :1])
    noise = 0.05 * numpy_rng(1).normal(size=(PIXELS, 3))
    moving = (texture + lobe(seen) + noise).astype(np.float32)
    body = np.zeros((TEXELS, TEXELS), int)
    found, choice = fitted(seen, moving, np.ones(PIXELS), photo, body)
    off = found.color(seen) - lobe(seen)
    assert (off - off.mean(0)).std() < 0.25 * lobe(seen).std()  # the texture takes what is constant
    assert choice["groups"] == 1 and choice["left"] < 0.8


def test_no_highlight_is_found_where_photos_differ_by_chance():
    seen, photo = reflections(2)
    moving = (0.1 * numpy_rng(3).normal(size=(PIXELS, 3))).astype(np.float32)
    body = np.zeros((TEXELS, TEXELS), int)
    found, choice = fitted(seen, moving, np.ones(PIXELS), photo, body)
    assert choice["left"] > 0.99
    assert found.color(seen).std(0).max() < 0.01


def test_groups_of_colours_have_highlights_of_their_own():
    seen, photo = reflections(4)
    body = np.zeros((TEXELS, TEXELS), int)
    body[: TEXELS // 2] = 1
    glossy = seen.uv[:, 1:] > 0.5  # row 0 is v 1
    moving = (glossy * lobe(seen)).astype(np.float32)
    found, choice = fitted(seen, moving, np.ones(PIXELS), photo, body)
    assert choice["groups"] == 2 and choice["left"] < 0.15
    matt = found.color(seen)[seen.uv[:, 1] < 0.4]
    assert matt.std(0).max() < 0.05 * lobe(seen).std(0).max()


def test_texels_without_kept_photos_count_for_nothing():
    seen, photo = reflections(5)
    moving = lobe(seen).astype(np.float32)
    body = np.zeros((TEXELS, TEXELS), int)
    made, _ = fitted(seen, moving, np.ones(PIXELS), photo, body)
    kept = seen.uv[:, 0] < 0.5
    own, judged = products(seen, moving, np.ones(PIXELS), kept, made)
    assert own[2] > 0 and judged[2] < 0.1 * own[2]
    none, all_ = products(seen, moving, np.ones(PIXELS), np.zeros(PIXELS, bool), made)
    assert none[2] == 0 and all_[2] == pytest.approx(0)
