"""Rows on the mean of samples, and their table."""

import numpy as np
import pytest

from benchmarks.mean_of_samples import samples_in, with_mean
from benchmarks.tables.means import SCORES, ahead, cell, of_study, pairs
from pipeline.base.errors import InputError
from pipeline.render.stacking import LeftOut
from tests.render.test_renderer import explanation

ROWS = [
    {
        "scene": f"scene {k}",
        "preset": "draft",
        "samples": [dict.fromkeys(SCORES, 20.0 + k), dict.fromkeys(SCORES, 22.0 + k)],
        "mean": dict.fromkeys(SCORES, 23.0 + 2 * k),
    }
    for k in range(3)
]


def test_samples_are_read_in_order_and_their_mean_comes_last(tmp_path):
    for k in (0, 10, 2, 1, 3, 4, 5, 6, 7, 8, 9):
        explanation(16, 8, seed=k).save(tmp_path / str(k))
        LeftOut.by_none().save(tmp_path / str(k))
    (tmp_path / "0.log").touch()
    *samples, mean = with_mean(samples_in(tmp_path))
    assert len(samples) == 11
    for k, x in enumerate(samples):
        np.testing.assert_allclose(x.base_color, explanation(16, 8, seed=k).base_color)
    expected = np.mean([x.light for x in samples], 0)
    np.testing.assert_allclose(mean.light, expected, rtol=1e-5)


def test_one_sample_has_no_mean_and_the_message_says_so(tmp_path):
    explanation(16, 8, seed=0).save(tmp_path / "0")
    with pytest.raises(InputError, match="fewer than two"):
        samples_in(tmp_path)


def test_a_scene_counts_once_however_many_samples_it_has():
    """Samples 21, 22, 23 in the mean, their means 23, 25, 27: ahead by 2, 3, 4."""
    np.testing.assert_allclose(pairs(ROWS, "relight_psnr"), [[21, 23], [22, 25], [23, 27]])
    assert cell(ROWS, "relight_psnr") == "22.0 \\| 25.0 (+3.0 ± 0.6)"
    assert ahead(ROWS, min) == "3 of 3" and ahead(ROWS[:1] + ROWS, sum) == "0 of 4"


def test_samples_and_means_of_a_study_are_joined_by_scene():
    """A scene without a mean is left out."""
    at = lambda scene, method, score: {"scene": scene, "method": method, "scores": score}
    rows = [at("a", "preset_draft", 1), at("a", "preset_draft", 2), at("b", "preset_draft", 3)]
    rows += [at("a", "preset_draft_mean", 4), at("a", "preset_standard_mean", 5)]
    assert of_study({"rows": rows}, "draft") == [{"samples": [1, 2], "mean": 4}]
