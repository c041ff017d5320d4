"""A run of the study that was cut off goes on without making a row twice, on a tiny scene."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.from_photos import against_truth
from benchmarks.make_scene import Options, make_scene
from benchmarks.stability.chain import chain
from benchmarks.study import methods, rows
from benchmarks.study.methods import MEANT, Method, scene_for
from benchmarks.study.rescore import rescore
from benchmarks.study.store import TOGETHER, row_file, seeds_in
from benchmarks.study.together import join
from benchmarks.suite.lights import make_light
from benchmarks.suite.objects import write_object
from pipeline.base.config import Fit
from pipeline.base.errors import InputError
from pipeline.base.files import read_json, write_json
from pipeline.base.images import write_exr
from pipeline.posterior.choose.chosen import chosen_scene
from pipeline.render.renderer import Explanation
from pipeline.render.samples import Samples
from pipeline.render.stacking import LeftOut
from pipeline.report.score import Scored, relight_psnr, true_pictures
from pipeline.report.truth import load_truth

pytestmark = pytest.mark.slow
SIDE = 32


@pytest.fixture
def photos(tmp_path, monkeypatch, one_thread):
    """The folder of a scene whose stages up to the fit lie in work/ beside it."""
    monkeypatch.setattr(methods, "TEXTURE", SIDE)
    write_object("vase", tmp_path / "asset", SIDE)
    lights = [tmp_path / f"{name}.exr" for name in ("room_0", "sunny_1")]
    for file in lights:
        write_exr(file, make_light(file.stem, 16))
    folder = tmp_path / "vase__room_0"
    options = Options(size=SIDE, spp=4, views=6, test=1)
    make_scene(tmp_path / "asset", lights[0], lights[1:], options, folder)
    scene = scene_for("map", str(folder))
    chain(
        scene.model_copy(update={"fit": Fit(steps=5, texture=SIDE)}),
        tmp_path / "work" / folder.name,
    )
    return folder


def test_no_row_is_made_twice(photos, tmp_path, monkeypatch, capsys):
    """Cut off in the third row, a run makes that one again and no other; then the draws are joined,
    once, and stay joined where a further draw's pictures are elsewhere."""
    drawn = []
    draw = rows.draw

    def cut_off(method, scene, folders, seed):
        drawn.append(seed)
        if drawn == [0, 1, 2]:
            raise KeyboardInterrupt
        return draw(method, scene, folders, seed)

    monkeypatch.setattr(rows, "draw", cut_off)
    kept = tmp_path / "rows"
    place = kept / photos.name / "map"
    run = lambda: rows.measure(
        "map", photos, tmp_path / "work", [0, 1, 2], kept, tmp_path / "draws", {"suite": "tiny"}
    )
    with pytest.raises(KeyboardInterrupt):
        run()
    assert seeds_in(place) == [0, 1]
    before = [row_file(kept, photos.name, "map", seed).read_bytes() for seed in (0, 1)]

    run()
    run()
    assert drawn == [0, 1, 2, 2]
    assert [row_file(kept, photos.name, "map", seed).read_bytes() for seed in (0, 1)] == before
    assert read_json(place / "2.json")["suite"] == "tiny"

    together = lambda: join(photos, "map", kept, tmp_path / "draws", {"suite": "tiny"})
    together()
    assert read_json(place / TOGETHER)["seeds"] == [0, 1, 2]
    joined = (place / TOGETHER).stat().st_mtime_ns
    together()
    write_json(place / "3.json", {})
    together()
    assert "map/3.npz" in capsys.readouterr().err
    assert (place / TOGETHER).stat().st_mtime_ns == joined


def test_a_changed_metric_is_scored_from_kept_pictures(photos, tmp_path):
    """Of the row's own draw only: half as bright as the truth, which alignment mends."""
    truth = load_truth(photos)
    half = {
        name: 0.5 * np.stack([shown.pixels, shown.pixels if shown.again is None else shown.again])
        for name, (_, shown, _) in true_pictures(truth).items()
    }
    scored = Scored({}, {}, half, np.zeros((1, 3)), np.zeros((2, 4, 3)))
    x = Explanation(np.ones((16, 32, 3)), *(np.ones((4, 4)),) * 3)
    pack = tmp_path / "draws" / photos.name / "map" / "0.npz"
    pack.parent.mkdir(parents=True)
    rows.keep_pictures(pack, scored, x)

    right, other = tmp_path / "right.json", tmp_path / "other.json"
    scores = {"relight_psnr": relight_psnr(half, truth), "relight_psnr_channel": 1.0, "light": 2.0}
    write_json(right, {"white": truth.white, "seed": 0, "scores": scores})
    write_json(other, {"white": truth.white, "scores": scores | {"relight_psnr": 40.0}})
    assert rescore(right, pack, photos, "abc") is None
    found = read_json(right)
    assert found["scores"].pop("relight_psnr_channel") > scores["relight_psnr"] + 10
    assert found["scores"] == {k: scores[k] for k in ("relight_psnr", "light")}
    assert found["seed"] == 0 and found["rescored"] == {"relight_psnr_channel": "abc"}

    before = other.read_bytes()
    assert "another draw" in rescore(other, pack, photos, "abc")
    assert "there is no" in rescore(other, tmp_path / "none.npz", photos, "abc")
    assert other.read_bytes() == before


def test_a_shipped_preset_is_measured_as_users_get_it(photos, tmp_path, monkeypatch):
    """With what choose decides, a fit of its own by that, and the preset's refinement; what is made
    once for all draws is no part of a draw's cost. `map` stands for the sampler: it is fast.
    """
    refined = []
    refine = rows.refine

    def watched(problem, drawn, settings, *rest):
        refined.append(settings)
        return refine(problem, drawn, settings, *rest)

    monkeypatch.setattr(rows, "refine", watched)
    monkeypatch.setitem(methods.METHODS, "preset_draft", Method("map", "draft", shipped=True))
    draws = tmp_path / "draws"
    rows.measure("preset_draft", photos, tmp_path / "work", [0], tmp_path / "rows", draws)

    fit = draws / photos.name / "preset_draft" / "fit"
    chosen = chosen_scene(scene_for("preset_draft", str(photos)), fit)
    assert refined == [chosen.refine] and chosen.refine.gloss == "tested"
    assert chosen.refine.texture <= 2 * SIDE < scene_for("preset_draft", str(photos)).refine.texture
    assert len(Explanation.load(fit).base_color) == chosen.fit.texture
    row = read_json(row_file(tmp_path / "rows", photos.name, "preset_draft", 0))
    assert row["cost"].keys() == {"sample", "refine"} and row["once"].keys() == {"choose", "fit"}


def test_a_mean_is_made_of_the_draws_that_are_kept(photos, tmp_path, monkeypatch):
    """It takes what they take together, and draws nothing; without them it says what is missing."""
    monkeypatch.setitem(methods.METHODS, "map", Method("map"))
    mean = Method("map", mean_of="map", drawn=False)
    monkeypatch.setitem(methods.METHODS, "map_mean", mean)
    kept, made = tmp_path / "kept", tmp_path / "rows"
    measure = lambda method, seeds: rows.measure(
        method, photos, tmp_path / "work", seeds, made, tmp_path / "draws", keep=kept
    )
    measure("map", [0, 1])
    with pytest.raises(InputError, match=r"map/2: a draw that the mean is made of is missing"):
        measure("map_mean", [0])

    measure("map", [2])
    monkeypatch.setattr(rows, "draw", None)
    measure("map_mean", [0])
    of_draws = [
        read_json(row_file(made, photos.name, "map", seed))["cost"]["refine"]["rays"]
        for seed in range(MEANT)
    ]
    row = read_json(row_file(made, photos.name, "map_mean", 0))
    assert row["cost"]["refine"]["rays"] == sum(of_draws) > 0
    draws = [Explanation.load(kept / photos.name / "map" / str(seed)) for seed in range(MEANT)]
    picture = np.load(tmp_path / "draws" / photos.name / "map_mean" / "0.npz")["sh"]
    weight = Samples([kept / photos.name / "map" / str(seed) for seed in range(MEANT)]).weights
    expected = np.average([rows.light_unknowns(x.light) for x in draws], 0, weight)
    np.testing.assert_allclose(picture, expected, rtol=1e-4, atol=1e-5)

    join(photos, "map_mean", made, tmp_path / "draws", {})
    held = read_json(made / photos.name / "map_mean" / TOGETHER)
    assert held["seeds"] == [*range(MEANT)] and held["scores"].keys() == {"within"}
    for shares in held["scores"]["within"].values():
        assert 0 <= shares["0.0"]["80%"] <= shares["0.04"]["80%"] <= 1


def test_samples_of_a_finished_run_are_scored_one_by_one_and_last_their_mean(photos, tmp_path):
    """One light four times as bright as the other, and its mean with that: levels are logs."""
    work = tmp_path / "work" / photos.name
    fit = Explanation.load(work / "fit")
    for k, factor in enumerate((1.0, 4.0)):
        folder = work / "refine" / str(k)
        replace(fit, light=np.float32(factor) * fit.light).save(folder)
        LeftOut.by_none().save(folder)
    found = against_truth(photos, work)

    one, four = (sample["light_level"] for sample in found["samples"])
    assert four - one == pytest.approx(np.log(4), abs=1e-3)
    assert found["mean"]["light_level"] - one == pytest.approx(np.log(2.5), abs=1e-3)
    scored = [*found["samples"], found["mean"]]
    assert len({scores["novel_view_psnr"] for scores in scored}) == 3
    shape = [scores["light_psnr_log"] for scores in scored]  # taken after one factor
    assert shape == pytest.approx([shape[0]] * 3, abs=1e-3)
