"""The trust score's model: kinds, fit, leave-scenes-out figures."""

from __future__ import annotations

from dataclasses import asdict

import numpy as np
import pytest

from benchmarks import trust_tables
from benchmarks.trust import auroc, chances, drawn, figures, fitted, kind_of, left_out
from pipeline.base.errors import InputError
from pipeline.report.trust import Evidence
from tests.seeds import numpy_rng


def rows(informative: bool, count: int = 40) -> list[dict]:
    """Runs of 8 kinds; informative: what is explained tells how well they are relit, to 1 dB."""
    rng = numpy_rng(1)
    out = []
    for k in range(count):
        explained = rng.uniform(10, 32)
        relight = explained - 4 + rng.normal() if informative else rng.uniform(8, 28)
        found = Evidence(rng.uniform(15, 30), explained, rng.uniform(0, 0.5), 0.97)
        out.append(
            {
                "scene": f"s_vase_k{k % 8}_{k // 8}",
                "evidence": asdict(found),
                "relight_psnr": relight,
            }
        )
    return out


def test_kinds_are_knobs_and_objects():
    """Not their values, bases, sizes or lights: a model that saw those has seen the kind."""
    assert kind_of("s_vase_blur_1p5") == kind_of("xs_figure_blur_4") == "blur"
    assert kind_of("s_vase_mask_shrunk_m3") == "mask_shrunk"
    assert kind_of("s_vase_sun_1e+05") == "sun"
    assert kind_of("s_vase") == kind_of("xs_vase__room_4") == kind_of("d_vase__sunny_12") == "vase"
    assert kind_of("bob_bronze__indoor_market") == "bob_bronze"
    assert kind_of("toy_car__river_road_2") == "toy_car"


def test_auroc_counts_pairs():
    failed = np.array([True, True, False, False])
    assert auroc(np.array([0.9, 0.8, 0.1, 0.2]), failed) == 1
    assert auroc(np.array([0.5, 0.5, 0.5, 0.5]), failed) == 0.5
    assert auroc(np.array([0.9, 0.1, 0.5, 0.2]), failed) == 0.5


def test_the_fit_finds_what_tells():
    runs = rows(informative=True, count=400)
    model = fitted(runs)
    assert model["weights"][1] < 0 and abs(model["weights"][1]) > 3 * abs(model["weights"][0])
    assert figures(runs)["auroc"] > 0.97
    with pytest.raises(InputError, match="all runs fail, or none"):
        fitted([row | {"relight_psnr": 30.0} for row in runs])


def test_left_out_kinds_are_judged_unseen():
    """On evidence that says nothing the score is no better than chance, however well it fits."""
    runs = rows(informative=False, count=400)  # of which chance alone makes .5 +- .03
    found = figures(runs)
    assert 0.3 < found["auroc"] < 0.65 and found["runs"] == 400 and found["kinds"] == 8
    seen = chances(fitted(runs), runs)
    assert np.abs(seen - left_out(runs)).max() > 0.01


def test_examples_are_some_right_alarms_and_all_that_is_wrong():
    runs = rows(informative=True, count=400)
    chance, failed = left_out(runs), np.array([row["relight_psnr"] < 18 for row in runs])
    alarm = chance >= 0.5
    lines = trust_tables.examples(runs).splitlines()[2:]
    named = lambda what: {line.split("`")[1] for line in lines if f"| {what} |" in line}
    of = lambda chosen: {run["scene"] for run, yes in zip(runs, chosen) if yes}
    assert named("false alarm") == of(alarm & ~failed) and named("missed") == of(~alarm & failed)
    assert 0 < len(named("missed")) and 0 < len(named("false alarm"))
    assert len(named("right alarm")) == 3 and named("right alarm") < of(alarm & failed)
    least = min(chance[[run["scene"] in named("right alarm") for run in runs]])
    assert (chance[alarm & failed] > least).sum() == 2
    assert f"| runs below 18 dB under new light | {failed.sum()} |" in trust_tables.summary(runs)


def test_draws_are_taken_by_their_seeds(tmp_path):
    """Draws of one method, without what else lies beside them."""
    place = tmp_path / "draws" / "a" / "map"
    for name in ("10", "9", "0", "fit"):
        (place / name).mkdir(parents=True)
    (place / "0.npz").touch()
    assert [path.name for path in drawn(tmp_path, "a", "map")] == ["0", "9", "10"]
    assert drawn(tmp_path, "a", "gaussian") == drawn(tmp_path, "b", "map") == []
