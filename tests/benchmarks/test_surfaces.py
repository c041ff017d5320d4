"""The surface at several settings: what is asked of the chain, rows, table and chart."""

import sys

import pytest

from benchmarks import surfaces
from benchmarks.surfaces_tables import choice, table
from pipeline.base.config import parse_scene
from pipeline.base.errors import InputError
from pipeline.base.files import read_json, write_json


def found(name: str, seconds: float, score: float) -> dict:
    truth = {"f1_at_1_percent_of_size": score, "f1_at_half_percent": score / 2}
    truth |= {"chamfer_percent_of_diagonal": 0.25, "normal_error_median_degrees": 6.5}
    return {"setting": name, "core_seconds": seconds, "peak_gib": 1.0, "faces": 30000} | {
        "unlit_psnr": 20 * score,
        "truth": truth,
    }


def test_every_setting_is_a_valid_configuration_of_its_own():
    scenes = [
        parse_scene({"photos": "x"} | changes, name)
        for name, changes in surfaces.settings_by_name().items()
    ]
    assert len({str(scene.mesh) + str(scene.atlas) for scene in scenes}) == len(scenes)


def test_the_table_goes_from_fast_to_slow():
    lines = table({"rows": [found("slow", 90, 0.9), found("fast", 5.2, 0.5)]}).splitlines()
    assert lines[2].startswith("| fast | 5 | 1.00 | 30,000 | .500 | .250 | .25 | 6.5 | 10.0 |")
    assert lines[3].startswith("| slow | 90 |")


def test_the_choice_is_between_fast_and_good():
    """What is slower and worse than another is not named."""
    rows = [found("slow", 90, 0.9), found("fast", 5.2, 0.5), found("vain", 100, 0.4)]
    said = choice({"rows": rows})
    assert "`slow` (90" in said and "`fast` (5.2" in said and "vain" not in said


def test_the_chart_names_every_setting(tmp_path):
    surfaces.chart({"rows": [found("slow", 90, 0.9), found("fast", 5, 0.5)]}, tmp_path / "s")
    text = (tmp_path / "s.svg").read_text()
    assert text.count(">slow<") == 3 and text.count(">fast<") == 3
    assert (tmp_path / "s.png").stat().st_size > 5000


def test_rows_are_made_once_from_what_settings_share(tmp_path, monkeypatch):
    """Mesh and atlas are timed, the stages before and after are not."""
    ran = []

    def run_chain(project, scene, settings, targets):
        (made,) = targets
        ran.append((project.name, made))
        stage = made.split("/")[-2]
        for name in {"masks": ["masks"], "atlas": ["mesh", "atlas"], "observe": ["observe"]}[stage]:
            facts = {"seconds": 1.0, "peak_gib": 2.0, "method": "fused", "faces": 7}
            write_json(project / "work" / "garden" / name / f"{name}.json", facts)
        return {"masks": 100.0, "atlas": 10.0, "observe": 1.0}[stage]

    monkeypatch.setattr(surfaces, "run_chain", run_chain)
    unlit = lambda work, texture, erode: ({"robust": {"a": 20.0, "b": 22.0}}, None)
    monkeypatch.setattr(surfaces, "score_unlit", unlit)
    monkeypatch.setattr(surfaces, "against_truth", lambda photos, work: {"f": 1})
    monkeypatch.setattr(surfaces, "settings_by_name", lambda: {"a b": {}, "c": {"mesh": {}}})
    monkeypatch.setattr(sys, "argv", ["x", "--out", str(tmp_path)])
    for _ in range(2):
        surfaces.main()
    shared, own = [r for r in ran if r[0] == "shared"], [r for r in ran if r[0] != "shared"]
    assert len(shared) == 1 and [name for name, _ in own] == ["a_b", "a_b", "c", "c"]
    row = read_json(tmp_path / "rows" / "a_b.json")
    assert (row["core_seconds"], row["unlit_psnr"], row["faces"]) == (10.0, 21.0, 7)
    assert row["seconds"] == {"mesh": 1.0, "atlas": 1.0}

    monkeypatch.setattr(sys, "argv", ["x", "--out", str(tmp_path), "--gather", str(tmp_path / "g")])
    surfaces.main()
    assert [r["setting"] for r in read_json(tmp_path / "g")["rows"]] == ["a b", "c"]
    nowhere = ["x", "--out", str(tmp_path / "elsewhere"), "--gather", str(tmp_path / "g")]
    monkeypatch.setattr(sys, "argv", nowhere)
    with pytest.raises(InputError, match="no rows"):
        surfaces.main()
    monkeypatch.setattr(sys, "argv", ["x"])
    with pytest.raises(InputError, match="no folder"):
        surfaces.main()
