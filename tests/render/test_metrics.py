"""Scores from a part of the pixels, and how sure they are."""

import numpy as np

from pipeline.render.metrics import crossed_error, psnr, some_of, standard_error
from tests.seeds import numpy_rng


def test_some_of_a_mask():
    mask = np.zeros((40, 50), bool)
    mask[5:25, 10:40] = True
    chosen = some_of(mask, 0.1, numpy_rng(0))
    assert chosen.sum() == 60 and not (chosen & ~mask).any()
    assert (some_of(mask, 7.0, numpy_rng(0)) == mask).all()


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


def test_all_pixels_leave_no_error_and_one_leaves_it_open():
    error = numpy_rng(0).random((50, 3))
    assert standard_error(error, 50) == 0
    assert standard_error(error[:1], 50) == np.inf
