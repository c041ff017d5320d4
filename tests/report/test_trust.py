"""How far an asset may be relied on: evidence, chance, words."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipeline.geometry.cameras import load_cameras
from pipeline.render.renderer import Explanation
from pipeline.report import trust
from pipeline.report.trust import (
    ADVICE,
    FROM_PHOTOS,
    NO_EVIDENCE,
    Evidence,
    agreement,
    evidence,
    in_words,
    level,
    load_model,
    outline,
    overcast_light,
    probability,
    small_views,
    weighing,
)
from tests.report.test_report import SCENE, work  # noqa: F401  (fixture)
from tests.seeds import numpy_rng

GOOD = Evidence(agreement=27.0, explained=29.0, level=0.1, outline=0.98)
MODEL = {
    "limit": 18.0,
    "intercept": 9.0,
    "weights": [-2.0, -2.0, 1.0, 0.5],
    "usual": GOOD.vector().tolist(),
}


def test_agreement_is_the_psnr_between_draws(rng_pictures):
    base, mask = rng_pictures
    other = np.clip(base + 0.1, 0, 1)
    pair = lambda picture: [np.stack([picture, picture])]
    near, far = agreement([pair(base), pair(base)], [mask]), None
    assert near > 99
    far = agreement([pair(base), pair(other)], [mask])
    three = agreement([pair(base), pair(base), pair(other)], [mask])
    assert far < 30 and three == pytest.approx((near + 2 * far) / 3)
    with pytest.raises(ValueError, match="one draw"):
        agreement([pair(base)], [mask])


@pytest.fixture
def rng_pictures():
    rng = numpy_rng(0)
    return rng.random((8, 8, 3)).astype(np.float32), np.ones((8, 8), bool)


def test_level_is_the_spread_of_log_brightness():
    lights = [np.full((4, 8, 3), value) for value in (1.0, np.e, np.e**2)]
    assert level(lights) == pytest.approx(1.0)
    assert (
        overcast_light(16).mean() > 0
        and overcast_light(16)[:4].mean() > overcast_light(16)[8:].mean()
    )


def test_chance_rises_as_each_figure_gets_worse():
    start = probability(GOOD, MODEL)
    for worse in ({"agreement": 15.0}, {"explained": 15.0}, {"level": 1.0}, {"outline": 0.5}):
        assert probability(replace(GOOD, **worse), MODEL) > start
    assert probability(replace(GOOD, agreement=41), MODEL) == probability(
        replace(GOOD, agreement=90), MODEL
    )


def test_words_name_what_weighs():
    assert in_words(None, MODEL, given=True) == [NO_EVIDENCE]
    (alone,) = in_words(replace(GOOD, agreement=30, explained=32), MODEL, given=True)
    assert alone.startswith("Nothing in this run")
    bad = replace(GOOD, explained=9.0)
    assert weighing(bad, MODEL) == ["explained"]
    steep = MODEL | {"weights": [-2.0, -8.0, 1.0, 0.5], "intercept": 26.0}
    said = in_words(bad, steep, given=True)
    assert said[0].startswith("Do not rely") and said[1:] == [ADVICE["explained"]]


def test_no_surface_made_from_photos_is_called_safe():
    """The model has seen given meshes alone."""
    first, second = in_words(replace(GOOD, agreement=30, explained=32), MODEL, given=False)
    assert first.startswith("Look closely") and second == FROM_PHOTOS
    steep = MODEL | {"weights": [-2.0, -8.0, 1.0, 0.5], "intercept": 26.0}
    said = in_words(replace(GOOD, explained=9.0), steep, given=False)
    assert said[0].startswith("Do not rely")
    assert said[1:] == [FROM_PHOTOS, ADVICE["explained"]]


def test_the_shipped_model_fits_the_evidence():
    model = load_model()
    assert len(model["weights"]) == len(model["usual"]) == len(GOOD.vector())
    hopeless = Evidence(agreement=8.0, explained=9.0, level=1.0, outline=0.4)
    assert probability(GOOD, model) < 0.2 < 0.8 < probability(hopeless, model)


@pytest.mark.slow
def test_evidence_of_a_run(work, monkeypatch):  # noqa: F811
    monkeypatch.setattr(trust, "SPP", 8)  # enough to tell one draw from another
    rig = load_cameras(work / "poses" / "cameras.json")
    draws = [Explanation.load(work / "refine" / str(k)) for k in range(2)]
    found = evidence(work, rig, draws, SCENE, [30.0, 31.0])
    assert found.explained == 30.5 and found.outline > 0.85 and 5 < found.agreement < 40

    same = evidence(work, rig, [draws[0], draws[0]], SCENE, [30.0])
    assert same.agreement > 35 and same.level == 0
    brighter = replace(draws[0], light=np.float32(2) * draws[0].light)
    assert evidence(work, rig, [draws[0], brighter], SCENE, [30.0]).level == pytest.approx(
        np.log(2) / np.sqrt(2)
    )
    assert evidence(work, rig, draws[:1], SCENE, [30.0]) is None
    assert evidence(work, rig, draws, SCENE, []) is None

    views = small_views(work, rig, "mesh/masks")
    half = [(view, mask & (np.arange(mask.shape[1]) < mask.shape[1] // 2)) for view, mask in views]
    assert 0.4 < outline(work / "atlas" / "mesh_uv.ply", half) < 0.6
