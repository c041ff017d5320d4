"""Which surface predicts photos that were left out, on a ball whose photos are computed."""

from dataclasses import replace

import numpy as np
import pytest

from pipeline.geometry.voxels import Grid
from pipeline.surface.fusion import _judged
from pipeline.surface.prediction import FOLDS, Gain, gain, gain_around
from tests.conftest import sphere


def photo(view, texture):
    """Picture (h, w) of the sphere of radius 0.5 at the origin, 0 beside it, and its mask."""
    origin, direction = view.rays(view.pixel_centers())
    direction = direction / np.linalg.norm(direction, axis=-1, keepdims=True)
    along = (origin * direction).sum(-1)
    inside = along**2 - (origin**2).sum(-1) + 0.25
    hit = inside > 0
    at = origin + (-along - np.sqrt(np.where(hit, inside, 0)))[..., None] * direction
    return np.where(hit, texture(at), 0).astype(np.float32), hit


def striped(at):
    """A texture of a few pixels' detail."""
    return 0.5 + 0.4 * np.sin(13 * at[..., 0]) * np.sin(11 * at[..., 1]) * np.sin(9 * at[..., 2])


def plain(at):
    """No texture at all."""
    return np.full(at.shape[:-1], 0.4)


@pytest.fixture
def judged(ring):
    """judged(simple, rich, texture) -> Gain."""
    views = ring(11, 72)

    def of(simple, rich, texture):
        images, masks = zip(*(photo(view, texture) for view in views))
        return gain(simple, rich, views, list(images), list(masks))

    return of


def swollen(mesh, factor):
    """The mesh about the origin, `factor` times as large."""
    return replace(mesh, vertices=factor * mesh.vertices)


def test_the_surface_where_it_is_predicts_better(judged):
    """A hull that is too large puts one triangle's pixels on different points."""
    true = sphere(4)
    found = judged(swollen(true, 1.15), true, striped)
    assert found.clear(given=True) and found.share > 0.5 and found.photos == 11
    back = judged(true, swollen(true, 1.15), striped)
    assert not back.clear(given=False) and back.share < 0


def test_a_surface_that_is_caved_in_does_not_fill_the_outline(judged):
    """Flattened to half its height it covers about half of what level views show."""
    true = sphere(4)
    assert judged(swollen(true, 1.15), true, striped).empty < 0.03
    flat = replace(true, vertices=true.vertices * [1, 0.5, 1])
    found = judged(true, flat, striped)
    assert 0.2 < found.empty < 0.5 and not found.fills
    assert judged(flat, true, striped).empty == 0


def test_plain_photos_ask_for_nothing(judged):
    true = sphere(3)
    assert not judged(swollen(true, 1.15), true, plain).clear(given=False)


def test_the_same_surface_gains_nothing(judged):
    found = judged(sphere(3), sphere(3), striped)
    assert found.share == 0 and not found.clear(given=False)


def test_fewer_photos_than_folds_are_left_out_one_by_one(ring):
    views = ring(FOLDS - 2, 48)
    images, masks = zip(*(photo(view, striped) for view in views))
    found = gain(swollen(sphere(3), 1.15), sphere(3), views, list(images), list(masks))
    assert found.photos == FOLDS - 2 and np.isfinite(found.share)


def test_the_hull_of_made_masks_is_left_for_less():
    """It has the errors of those masks; chance is left to chance either way."""
    found = Gain(0.08, 0.016, 41, 0.0)
    assert found.clear(given=False) and not found.clear(given=True)
    assert not replace(found, standard_error=0.05).clear(given=False)


def test_large_photos_are_looked_at_smaller(ring, monkeypatch):
    """The answer is the same from a tenth of the pixels."""
    views = ring(8, 96)
    images, masks = zip(*(photo(view, striped) for view in views))
    monkeypatch.setattr("pipeline.surface.prediction.PIXELS", sum(m.sum() for m in masks) / 10)
    found = gain(swollen(sphere(3), 1.3), sphere(3), views, list(images), list(masks))
    assert found.clear(given=True)


def test_a_fused_surface_has_to_predict_better_and_to_fill_the_masks():
    caved = Gain(share=0.3, standard_error=0.04, photos=40, empty=0.16)
    for given in (True, False):
        taken, words = _judged(caved, given, 0.1)
        assert not taken and "16 % of what the hull fills" in words
        assert _judged(replace(caved, empty=0.06), given, 0.1)[0]
    assert _judged(replace(caved, empty=0.05), given=True, wrong=0.1)[0]
    assert not _judged(replace(caved, empty=0.05, share=0.06), given=True, wrong=0.1)[0]


def test_a_fused_surface_is_refused_whose_depth_is_mostly_wrong():
    good = Gain(share=0.3, standard_error=0.04, photos=40, empty=0.01)
    taken, words = _judged(good, given=False, wrong=0.6)
    assert not taken and "60 % of all depth wrong" in words
    assert _judged(good, given=False, wrong=0.4)[0]


def test_around_a_point_the_photos_tell_which_surface_is_right(ring):
    """The rich surface is the ball's in front and caved in behind, the simple one is swollen in
    front and the ball's behind. Far from both no photo tells.
    """
    views = ring(11, 72)
    images, masks = zip(*(photo(view, striped) for view in views))
    true = sphere(4)
    front = true.vertices[:, :1] > 0
    simple = replace(true, vertices=np.where(front, 1.15, 1) * true.vertices)
    rich = replace(true, vertices=np.where(front, 1, 0.85) * true.vertices)
    grid = Grid.over(-0.65 * np.ones(3), 0.65 * np.ones(3), 64)
    share = gain_around(simple, rich, views, list(images), list(masks), grid)
    for mesh in (simple, rich):
        x, height = mesh.vertices[:, 0], np.abs(mesh.vertices[:, 1])
        found, sideways = share(mesh.vertices), height < 0.2
        assert np.median(found[sideways & (x > 0.2)]) > 0.4
        assert np.median(found[sideways & (x < -0.2)]) < -0.4
    assert share(np.full((1, 3), 0.65))[0] > 0.99
