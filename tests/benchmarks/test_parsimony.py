"""Rows of the parsimony benchmark and their tables."""

import numpy as np
import pytest

from benchmarks import parsimony
from benchmarks.parsimony import Job, carried
from benchmarks.parsimony_tables import (
    by_scene,
    coverage,
    coverage_by_scene,
    lost,
    share,
    summary,
)
from pipeline.base.files import read_json
from pipeline.render.renderer import Explanation


def variant(numbers, seconds, held_out, relit=None, settings=None):
    stages = {"choose": 4.0, "fit": seconds - 4.0}
    found = {
        "numbers": numbers,
        "cpu_seconds": seconds,
        "cpu_seconds_by_stage": stages,
        "held_out_psnr": held_out,
        "settings": settings or {},
        "gloss": None,
    }
    return found if relit is None else found | {"truth": {"relight_psnr": relit}}


def rows():
    chosen = {"refine": {"texture": 128, "gloss_texture": 64}, "render": {"max_depth": 2}}
    return [
        {
            "set": "w_bowl__room_1",
            "preset": "draft",
            "fixed": variant(1000, 104, 30.0, 25.0),
            "chosen": variant(100, 50, 30.05, 24.5, chosen),
        },
        {
            "set": "garden",
            "preset": "draft",
            "fixed": variant(1000, 104, 20.0),
            "chosen": variant(300, 90, 19.79, None, chosen),
        },
    ]


def test_choose_counts_only_where_it_chooses():
    assert share(rows()[0], "cpu_seconds") == pytest.approx(50 / 100)
    assert share(rows()[0], "numbers") == pytest.approx(0.1)


def test_losses_are_positive_where_the_chosen_model_is_worse():
    one, other = rows()
    assert lost(one, "held_out") == pytest.approx(-0.05)
    assert lost(one, "relight") == pytest.approx(0.5) and lost(other, "relight") is None


def test_summary_counts_scenes_within_each_limit():
    lines = summary(rows()).splitlines()
    cells = {line.split(" | ")[0].strip("| "): line.strip("| ").split(" | ")[1:] for line in lines}
    assert cells["numbers in the asset"] == ["20 % ± 10", "20 %", "30 %", "25 %", "1 of 2"]
    assert cells["processor seconds"] == ["70 % ± 20", "70 %", "90 %", "60 %", "1 of 2"]
    assert cells["held-out dB lost"] == ["+0.08 ± 0.13", "+0.08", "+0.21", "0.1", "1 of 2"]
    assert cells["relit dB lost"] == ["+0.50 ± 0.00", "+0.50", "+0.50", "0.2", "0 of 1"]


def test_what_is_beyond_a_limit_stands_out():
    bowl, garden = by_scene(rows()).splitlines()[2:]
    assert "bowl, room_1, draft | 128 / 64 | 2 | kept" in bowl
    assert "**+0.50**" in bowl and "**" not in bowl.replace("**+0.50**", "")
    assert "**30 %**" in garden and "**90 %**" in garden and "**+0.21**" in garden


def test_coverage_is_the_mean_over_the_kinds_of_unknowns():
    held = {"coverage": {"light": {"80%": 0.5}, "albedo": {"80%": 0.9}}}
    assert coverage(held) == pytest.approx(0.7) and coverage({}) is None


def test_what_intervals_hold_stands_scene_by_scene_and_in_the_mean():
    given = rows()
    for row, light in zip(given, (0.5, 0.9)):
        kinds = {"light": light, "relit": 0.25, "albedo": 0.75}
        row["chosen"]["coverage"] = {kind: {"80%": share} for kind, share in kinds.items()}
    lines = coverage_by_scene(given).splitlines()
    assert lines[0] == "| scene | light | relit pixels | base colour |"
    assert lines[2:] == [
        "| bowl, room_1 | 0.50 | 0.25 | 0.75 |",
        "| garden | 0.90 | 0.25 | 0.75 |",
        "| mean | 0.70 | 0.25 | 0.75 |",
    ]


def test_a_constant_map_counts_as_one_number():
    light, color = np.ones((4, 8, 3), np.float32), np.ones((16, 16, 3), np.float32)
    ramp = np.linspace(0, 1, 64, dtype=np.float32).reshape(8, 8)
    found = carried(Explanation(light, color, np.full((8, 8), 0.3, np.float32), ramp))
    assert found == {"base_color": 768, "light": 96, "roughness": 1, "metallic": 64}


def test_a_row_has_the_variants_that_were_asked_for(tmp_path, monkeypatch):
    """One alone, then both: the row is made anew, for it lacks one."""
    made = []
    monkeypatch.setattr(parsimony, "made_by", lambda *_: 0.0)
    monkeypatch.setattr(
        parsimony, "variant_row", lambda job, here, *_: made.append(here.name) or {}
    )
    ask = lambda *which: parsimony.make_row(Job("a", {}, None, "draft", {}, 1, which), tmp_path)
    assert read_json(ask("chosen")).keys() >= {"chosen"} and made == ["chosen"]
    assert "fixed" not in read_json(ask("chosen")) and made == ["chosen"]
    assert read_json(ask("fixed", "chosen")).keys() >= {"fixed", "chosen"}
    assert made == ["chosen", "fixed", "chosen"]
