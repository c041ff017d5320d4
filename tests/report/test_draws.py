"""The samples of a run: they are not all held at once, and their spread is exact."""

import weakref
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pipeline.base.files import write_json
from pipeline.base.images import linear_to_srgb
from pipeline.render.draw_metrics import COMMON_ERROR
from pipeline.render.renderer import Explanation
from pipeline.render.samples import Samples, Spread, asset_facts
from pipeline.render.stacking import LeftOut
from pipeline.render.surface_texels import SurfaceTexels
from pipeline.report.make import make_report
from tests.render.test_renderer import explanation
from tests.report import test_report
from tests.seeds import seeded

COUNT = 5

work = test_report.work  # the fixture: folders of a whole run


def test_the_report_holds_no_more_samples_than_it_draws(work, tmp_path, monkeypatch):
    """However many there are: one, the next while it is read, and one in a renderer's textures."""
    for k in range(COUNT):
        explanation(16, 8, seed=seeded(k)).save(work / "refine" / str(k))
        LeftOut.by_none().save(work / "refine" / str(k))
        write_json(work / "refine" / str(k) / "refine.json", {"held_out_psnr": 30.0})
        write_json(work / "sample" / str(k) / "sample.json", {"seconds": 4.0})

    alive = []
    most = []
    load = Explanation.load.__func__

    def counted(cls, folder):
        found = load(cls, folder)
        alive.append(1)
        weakref.finalize(found.base_color, alive.pop)
        most.append(len(alive))
        return found

    monkeypatch.setattr(Explanation, "load", classmethod(counted))
    write_json(work / "export.json", {"samples": COUNT})
    make_report(work, Path("x.usda"), tmp_path / "r.html", test_report.SCENE)
    assert len(most) >= COUNT and max(most) <= 3


def test_spread_is_that_of_all_samples_at_once(tmp_path):
    found = [explanation(16, 8, seed=seeded(k)) for k in range(COUNT)]
    for k, x in enumerate(found):
        x.save(tmp_path / "refine" / str(k))
    spread = Spread.of(Samples.of(tmp_path, COUNT))
    of_all = lambda values: np.std(values, axis=0, ddof=1)
    for name in ("roughness", "metallic"):
        expected = of_all([getattr(x, name) for x in found])
        np.testing.assert_allclose(getattr(spread, name), expected, rtol=1e-5, atol=1e-7)
    color = of_all([linear_to_srgb(x.base_color) for x in found])
    np.testing.assert_allclose(spread.color, color, rtol=1e-4, atol=1e-6)
    light = of_all([np.log(x.light / x.light.mean()) for x in found])
    np.testing.assert_allclose(spread.light, light, rtol=1e-3, atol=1e-5)
    assert spread.count == COUNT and Spread.of(found[:1]) is None


def test_an_asset_says_how_far_its_base_colour_may_be_off():
    """Alike samples: only what all samples may miss together; a single one says nothing, and what
    no photo shows does not count.
    """
    one = explanation(16, 8, seed=0)
    everywhere = np.ones((16, 16), bool)
    texels = SurfaceTexels(everywhere, everywhere)
    alike = asset_facts(Spread.of([one, one, one]), texels)
    assert alike["base_color_within"] == pytest.approx(1.2816 * COMMON_ERROR, abs=1e-3)
    other = replace(one, base_color=np.clip(one.base_color + 0.3, 0, 1))
    apart = asset_facts(Spread.of([one, other]), texels)
    assert (
        alike["base_color_within"] < apart["base_color_within"] <= apart["base_color_within_hard"]
    )
    assert apart["interval"] == 0.8 and alike["unseen_share"] == 0
    assert asset_facts(Spread.of([one]), texels) == {"unseen_share": 0}

    left = np.arange(16) < np.full((16, 1), 4)
    half_changed = replace(one, base_color=np.where(left[..., None], one.base_color, 1))
    found = asset_facts(Spread.of([one, half_changed]), SurfaceTexels(everywhere, left))
    assert found["unseen_share"] == 0.75
    assert found["base_color_within_hard"] < apart["base_color_within"]
