"""Scores from a part of the pixels, and how sure they are."""

from types import SimpleNamespace

import numpy as np
import pytest

from pipeline.base.files import read_json, report_metrics
from pipeline.geometry.cameras import View
from pipeline.render.metrics import (
    FEWEST_SCORED,
    crossed_error,
    psnr,
    score_held_out,
    some_of,
    standard_error,
)
from tests.seeds import numpy_rng


def test_some_of_a_mask():
    mask = np.zeros((40, 50), bool)
    mask[5:25, 10:40] = True
    chosen = some_of(mask, 0.1, numpy_rng(0))
    assert chosen.sum() == 60 and not (chosen & ~mask).any()
    assert (some_of(mask, 7.0, numpy_rng(0)) == mask).all()


def test_pixels_spread_evenly_tell_more_where_neighbours_err_alike():
    """Errors in patches of eight pixels, one pixel of five: less than .7 of the deviation that as
    many random ones would have, which is what the score claims (.5 at the seeds 0 to 4).
    """
    rng = numpy_rng(1)
    error = np.kron(rng.exponential(size=(16, 16, 1)), np.ones((8, 8, 3)))
    everywhere = np.ones(error.shape[:2], bool)
    chosen = [some_of(everywhere, 0.2, rng) for _ in range(200)]
    decibels = [10 * np.log10(error[some].mean()) for some in chosen]
    claims = [standard_error(error[some], everywhere.size) for some in chosen]
    assert np.std(decibels) < 0.7 * np.mean(claims)
    assert abs(np.mean([some.mean() for some in chosen]) - 0.2) < 1e-3
    assert np.mean(chosen, axis=0).std() < 0.05  # every pixel has its chance


def test_standard_error_is_the_spread_of_scores():
    rng = numpy_rng(0)
    truth = rng.random((80, 100, 3)).astype(np.float32)
    picture = truth + 0.1 * rng.standard_t(5, truth.shape).astype(np.float32)
    everywhere = np.ones(truth.shape[:2], bool)

    scores = []
    claims = []
    for _ in range(300):
        chosen = some_of(everywhere, 0.2, rng)
        scores.append(psnr(picture, truth, chosen))
        error = crossed_error(picture, truth, picture)[chosen]
        claims.append(standard_error(error, everywhere.size))
    assert abs(np.mean(claims) / np.std(scores) - 1) < 0.2
    assert abs(np.mean(scores) - psnr(picture, truth)) < 0.05


def test_all_pixels_leave_no_error_and_one_of_several_has_none():
    error = numpy_rng(0).random((50, 3))
    assert standard_error(error, 50) == 0
    assert standard_error(error[:1], 1) == 0
    with pytest.raises(ValueError, match="1 pixel out of 50"):
        standard_error(error[:1], 50)


class FlatRenderer:
    """Every ray sees the same grey, and a little noise."""

    def set(self, explanation):
        pass

    def mean_radiance(self, rays, spp, seed):
        rng = numpy_rng(seed)
        origins, _ = rays(rng)
        return 0.4 + 0.01 * rng.standard_normal(origins.shape)


@pytest.mark.parametrize("inner", [1, 2, 24])
def test_a_view_that_shows_next_to_nothing_is_scored_and_written_down(tmp_path, inner):
    """Its share of all scored pixels would be less than one."""
    held_out = []
    for name, pixels in (("whole", 64 * 64), ("sliver", inner)):
        mask = np.zeros(64 * 64, bool)
        mask[:pixels] = True
        view = View(name, "", 64, 64, 64, 64, 32, 32, np.eye(4))
        # far from the picture's grey of .4, so that its noise is a small share of the error
        photo = numpy_rng(3).uniform(0.7, 1, (64, 64, 3)).astype(np.float32)
        held_out.append((view, photo, mask.reshape(64, 64)))

    problem = SimpleNamespace(renderer=FlatRenderer())
    scores = score_held_out(problem, None, held_out, 64, 2)
    report_metrics(tmp_path / "refine.json", scores)  # refuses infinity
    found = read_json(tmp_path / "refine.json")
    assert 0 < found["held_out_standard_error"] < 10
    _, photo, mask = held_out[1]
    if inner <= FEWEST_SCORED:  # all of it is looked at
        expected = psnr(np.full_like(photo, 0.4), photo, mask)
        assert abs(found["held_out"]["sliver"] - expected) < 0.5
