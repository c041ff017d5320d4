"""Weights of samples in their mean, by what they predict of photos left out."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.base.errors import InputError
from pipeline.render.samples import Samples
from pipeline.render.stacking import UNSEEN, LeftOut, weights
from tests.render.test_renderer import explanation
from tests.seeds import numpy_rng, seeded

PIXELS = 400


def judged(error, noise=None):
    """Of a sample that errs by `error` (n, 3), with each picture's noise (2, n, 3)."""
    noise = np.zeros((2, *error.shape)) if noise is None else noise
    return LeftOut(np.arange(len(error)), error + noise)


def error_of(found, w):
    """Mean square of the mixture's error where photos look, and where none looks, where samples err
    as much on average and each by itself.
    """
    one, two = (np.einsum("k,knc->nc", w, [x.residual[k] for x in found]) for k in range(2))
    of_samples = np.mean([(x.residual[0] * x.residual[1]).mean() for x in found])
    return float((one * two).mean() + UNSEEN * of_samples * (w**2).sum())


@given(st.integers(1, 6), st.integers(0, 1000))
def test_the_mixture_predicts_no_worse_than_any_sample_or_all_alike(count, seed):
    rng = numpy_rng(seed)
    scale = 10.0 ** rng.uniform(-3, 0, count)
    found = [judged(s * (rng.normal(size=(PIXELS, 3)) + rng.normal())) for s in scale]
    w = weights(found)
    assert w.shape == (count,) and (w >= 0).all() and w.sum() == pytest.approx(1)
    others = [np.full(count, 1 / count), *np.eye(count)]
    least = min(error_of(found, other) for other in others)
    assert error_of(found, w) <= 1.001 * least + 1e-9


def test_samples_that_err_the_other_way_count_alike_and_one_that_repeats_shares_its_weight():
    error = numpy_rng(0).normal(size=(PIXELS, 3))
    np.testing.assert_allclose(weights([judged(error), judged(-error)]), 0.5, atol=1e-3)
    of_three = weights([judged(error), judged(error), judged(-error)])
    assert of_three[2] > 1.2 * of_three[0]
    assert of_three[0] == pytest.approx(of_three[1], abs=1e-3)


def test_one_that_is_plainly_worse_counts_little_and_one_that_is_hardly_worse_alike():
    """Of independent errors of variance v and v' the weights are as 1 / (v + e), 1 / (v' + e)."""
    rng = numpy_rng(1)
    good, bad = 0.01 * rng.normal(size=(PIXELS, 3)), 0.2 + 0.1 * rng.normal(size=(PIXELS, 3))
    assert weights([judged(bad), judged(good)])[1] > 0.7
    like, hardly = (s * rng.normal(size=(40_000, 3)) for s in (0.1, 0.102))
    assert abs(weights([judged(like), judged(hardly)])[0] - 0.5) < 0.02


def test_the_noise_of_paths_does_not_count():
    """Of two samples with like errors the one of noisy pictures has the weight it has without."""
    rng = numpy_rng(2)
    one, two = (rng.normal(size=(40_000, 3)) for _ in range(2))
    noisy = judged(one, rng.normal(size=(2, 40_000, 3)))
    assert abs(weights([noisy, judged(two)])[0] - 0.5) < 0.05


def test_without_a_judge_all_count_alike(tmp_path):
    assert (weights([LeftOut.by_none()] * 4) == 0.25).all()
    for k in range(2):
        explanation(16, 8, seed=seeded(k)).save(tmp_path / str(k))
        LeftOut.by_none().save(tmp_path / str(k))
    assert (Samples([tmp_path / "0", tmp_path / "1"]).weights == 0.5).all()
    assert Samples([tmp_path / "never judged"]).weights == [1]


def test_what_is_saved_comes_back(tmp_path):
    made = judged(numpy_rng(3).normal(size=(PIXELS, 3)).astype(np.float32))
    made.save(tmp_path)
    found = LeftOut.load(tmp_path)
    assert np.array_equal(found.pixel, made.pixel)
    np.testing.assert_allclose(found.residual, made.residual, rtol=1e-6)


def test_samples_of_an_earlier_version_or_of_other_pixels_are_refused(tmp_path):
    with pytest.raises(InputError, match="refine it anew"):
        LeftOut.load(tmp_path)
    some = judged(np.ones((PIXELS, 3)))
    other = LeftOut(some.pixel + 1, some.residual)
    with pytest.raises(InputError, match="refine all samples of the scene anew"):
        weights([some, other])
