"""The samples of a run: they are not all held at once, and their spread is exact."""

import weakref
from pathlib import Path

import numpy as np

from pipeline.base.files import write_json
from pipeline.render.renderer import Explanation
from pipeline.report.draws import Samples, deviations
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
    scene = test_report.SCENE.model_copy(update={"samples": COUNT})
    make_report(work, Path("x.usda"), tmp_path / "r.html", scene)
    assert len(most) >= COUNT and max(most) <= 3


def test_deviations_are_those_of_all_samples_at_once(tmp_path):
    found = [explanation(16, 8, seed=seeded(k)) for k in range(COUNT)]
    for k, x in enumerate(found):
        x.save(tmp_path / "refine" / str(k))
    color, light = deviations(Samples(tmp_path, COUNT), lambda x: (x.base_color, x.light))
    np.testing.assert_array_equal(color, np.std([x.base_color for x in found], axis=0))
    np.testing.assert_array_equal(light, np.std([x.light for x in found], axis=0))
    (unbiased,) = deviations(found, lambda x: (x.metallic,), ddof=1)
    np.testing.assert_allclose(unbiased, np.std([x.metallic for x in found], axis=0, ddof=1))
