"""Finished work folders are scored in the unit that their capture stage has found."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from benchmarks.study import rows
from benchmarks.study.together import join
from pipeline.base.config import Capture
from pipeline.base.files import read_json
from pipeline.base.images import read_exr, write_exr
from pipeline.photos.capture import capture
from pipeline.photos.radiance import Radiance
from pipeline.render.stacking import LeftOut
from pipeline.report.truth import load_truth
from tests.report.test_score import scene, true_explanation  # noqa: F401  (a fixture)

BRIGHTER = 16.0  # photos that are not held out: alone they would give the scene this white, or so
METHOD = "map"


def in_exr(scene: Path, out: Path) -> None:  # noqa: F811
    """A copy of the scene's folder with photos in EXR, of which the held-out ones have the usual
    brightness and the others are BRIGHTER.
    """
    shutil.copytree(scene, out)
    for file, factor in (("transforms.json", BRIGHTER), ("transforms_test.json", 1.0)):
        cameras = read_json(out / file)
        for frame in cameras["frames"]:
            photo = out / frame["file_path"]
            photo.unlink()
            shown = factor * read_exr(out / "truth" / "linear" / f"{photo.stem}.exr")
            write_exr(photo.with_suffix(".exr"), shown)
            frame["file_path"] = f"images/{photo.stem}.exr"
        (out / file).write_text(json.dumps(cameras))


@pytest.mark.slow
def test_draws_are_scored_in_the_unit_of_their_work_folder(scene, ball, tmp_path, monkeypatch):  # noqa: F811
    """The truth as a draw, its light over the white that capture has written down, scores at the
    limit, alone and together with another. Over the white of the held-out photos it would be too
    dark.
    """
    photos, work = tmp_path / "out" / "scenes" / "ball", tmp_path / "work" / "ball"
    in_exr(scene / "scene", photos)
    (work / "capture").mkdir(parents=True)
    capture(photos, work / "capture", Capture())
    shutil.copytree(ball, work / "atlas")
    white = Radiance.load(work / "capture").white
    assert white > 2 * load_truth(photos).white

    x = true_explanation(scene)
    seconds = {"seconds": 1.0, "cpu_seconds": 1.0, "rays": 1}
    cost = {"sample": seconds, "refine": seconds}
    drawn = replace(x, light=x.light / white)
    monkeypatch.setattr(rows, "draw", lambda *which: (drawn, LeftOut.by_none(), cost))
    made, draws = tmp_path / "rows", tmp_path / "draws"
    rows.measure(METHOD, photos, tmp_path / "work", [0, 1], made, draws)

    # what 64 paths a picture leave
    alone = read_json(made / "ball" / METHOD / "0.json")["scores"]
    assert alone["relight_psnr"] > 33 and abs(alone["light_level"]) < 1e-3
    join(photos, METHOD, made, draws, {})
    together = read_json(made / "ball" / METHOD / "together.json")
    assert together["scores"]["relight_psnr_of_mean"] > 33
    assert together["scores"]["coverage"]["light"]["95%"] == 1
