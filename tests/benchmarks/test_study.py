"""Tables and charts of a study from rows whose figures are known."""

import json
import shutil
import sys
from itertools import combinations

import numpy as np
import pytest
from PIL import Image

from benchmarks.figures import pyplot
from benchmarks.study import __main__ as study
from benchmarks.study import pages, versions
from benchmarks.study.agreement_table import most, table
from benchmarks.study.charts import chart, charts
from benchmarks.study.front import (
    Point,
    choice,
    coverage_choice,
    coverage_points,
    front,
    relight_points,
    speed_against,
    unclear,
)
from benchmarks.study.intervals import paired, views_of
from benchmarks.study.labels import HEIGHT, apart, box_of
from benchmarks.study.losses import losses
from benchmarks.study.methods import METHODS, OURS, methods_named, scene_for
from benchmarks.study.pictures import draw
from benchmarks.study.scenes import scenes_of
from benchmarks.study.spread_pictures import spread_rows
from benchmarks.study.store import suite_rows
from benchmarks.study.tables import (
    coverage_error,
    levels,
    longer_down,
    mean_of,
    printed,
    scene_mean,
    scores,
    seconds,
    shares_held,
)
from benchmarks.study.yardstick_tables import means
from pipeline.base.config import parse_scene
from pipeline.base.errors import InputError
from pipeline.base.files import write_json
from pipeline.render.declared import METRICS
from tests.seeds import numpy_rng


def rows_of(method: str, level: float, cost: float, scenes=("a", "b"), seeds=(0, 1)) -> list[dict]:
    """Rows of a method whose scores are `level`, one higher in the second scene."""
    out = []
    for number, scene in enumerate(scenes):
        for seed in seeds:
            scores = dict.fromkeys(METRICS, level + number)
            part = {"seconds": 3 * cost, "cpu_seconds": cost, "rays": 1000}
            views = {f"relight/x/test_{k}": level + number + 0.1 * k + seed for k in range(4)}
            views["novel/test_0"] = 40.0
            cost_of = {"sample": part, "refine": part}
            row = {"scene": scene, "method": method, "seed": seed, "machine": "ours"}
            row |= {"scores": scores, "views": views, "cost": cost_of, "peak_gib": 1.0}
            out.append(row)
    return out


def together(method: str, held: float, scenes=("a", "b")) -> list[dict]:
    cover = {kind: {"50%": 0.5, "80%": held, "95%": 0.9} for kind in ("light", "relit", "albedo")}
    keys = ("relight_psnr_of_mean", "crps_relight", "crps_albedo")
    scores = dict.fromkeys((*keys, "variance_albedo", "variance_light"), 1.0)
    scores["coverage"] = cover
    return [{"scene": scene, "method": method, "scores": scores} for scene in scenes]


def test_a_table_goes_down_where_it_is_longer():
    wide = longer_down(["", "a", "b", "c"], [["one", "1", "2", "3"]])
    assert wide.split("\n")[0] == "|  | one |" and "| c | 3 |" in wide
    tall = longer_down(["", "a"], [["one", "1"], ["two", "2"]])
    assert tall.split("\n")[0] == "|  | a |" and "| two | 2 |" in tall


@pytest.fixture
def data() -> dict:
    rows = rows_of(OURS, 20, 5) + rows_of("dpi_paper", 18.5, 60) + rows_of("map", 15, 1, seeds=(0,))
    return {"rows": rows, "together": together(OURS, 0.7) + together("dpi_paper", 0.4)}


def test_means_are_of_scenes_and_only_where_all_have_rows(data):
    assert mean_of(data, OURS, "relight_psnr") == 20.5
    assert scene_mean(data, "b", "map", "albedo_mse") == 16
    assert seconds(data, "dpi_paper") == 120
    assert shares_held(data, OURS) == pytest.approx(np.full((2, 3), 0.7))
    assert shares_held(data, "map") is None
    data["rows"] = [r for r in data["rows"] if (r["scene"], r["method"]) != ("b", "map")]
    assert mean_of(data, "map", "relight_psnr") is None
    assert "`map`" not in scores(data) and "`dpi_paper`" in scores(data)


def test_errors_of_intervals_are_of_all_scenes_together():
    """All of one scene's unknowns inside, and six tenths of the other's: 80 % hold. One kind too
    wide by .1 does not make up for one too narrow by .1.
    """
    assert coverage_error(np.array([[1.0, 1.0], [0.6, 0.6]])) == pytest.approx(0)
    assert coverage_error(np.array([[0.9, 0.7], [0.9, 0.7]])) == pytest.approx(0.1)


def test_intervals_that_are_better_by_chance_are_said_to_be(data):
    """One scene for the one, one for the other; and better in both."""
    one, two = together(OURS, 0.7), together("dpi_paper", 0.6)
    assert "chance" not in coverage_choice(data | {"together": one + two})
    two[1]["scores"] = together("dpi_paper", 0.75)[1]["scores"]
    said = coverage_choice(data | {"together": one + two})
    assert said.endswith("That it is ahead of `dpi_paper` may be chance.")


def test_errors_of_intervals_have_bars_over_scenes(data):
    data["together"] = [*together(OURS, 0.7, ("a",)), *together(OURS, 0.5, ("b",))]
    (point,) = coverage_points(data)
    assert point.value == pytest.approx(0.2)
    assert (point.low, point.high) == pytest.approx((0.1, 0.1))


def test_pieces_of_a_study_are_named_as_one():
    """Rows name their scenes; the line below a table does not. A folder of scenes stays."""
    command = "python -m benchmarks.study --suite S{} --samples 1 --out FOLDER"
    said = [
        command.format(" --scenes s_a__x_1,s_b__y_2"),
        command.format(""),
        "a --scenes F/s --out o",
    ]
    about = {"suite": "S", "machine": "m", "commit": "c", "note": ""}
    rows = [about | {"method": OURS, "command": c} for c in said]
    line = pages.source({"rows": rows})
    assert line.count(command.format("")) == 1 and "s_a__x_1" not in line
    assert "`a --scenes F/s --out o`" in line


@pytest.mark.parametrize("other", [{"machine": "another"}, {"date": "another"}])
def test_times_of_two_machines_or_days_are_not_compared(data, other):
    """Rows from elsewhere have scores, and times only where ours stand beside them."""
    for row in rows_of("gaussian", 19, 1):
        data["rows"].append(row | other)
    assert mean_of(data, "gaussian", "relight_psnr") == 19.5
    assert seconds(data, "gaussian") is None
    assert "gaussian" not in [point.method for point in relight_points(data)]
    assert "| `gaussian` |  | 19.5 |" in printed(data)

    elsewhere = [row | other for row in rows_of(OURS, 20, 7, seeds=(2, 3, 4))]
    data["rows"] += elsewhere  # now the most of ours are from there
    assert seconds(data, OURS) == 14 and seconds(data, "gaussian") == 2
    assert seconds(data, "dpi_paper") is None
    data["rows"] = [row for row in data["rows"] if row["method"] != OURS]
    assert seconds(data, "gaussian") is None


def test_tables_hold_paired_differences(data):
    text = printed(data)
    line = next(row for row in text.splitlines() if row.startswith("| `dpi_paper` | -1.50"))
    assert "-1.50 (-1.50 to -1.50)" in line
    assert "| `map` less that | -5.5 (-5.5 to -5.5) | -5.5 (-5.5 to -5.5) |" in text
    assert f"| `{OURS}` | 20.6 | 21.6 |" in text
    assert "nan" not in text
    assert "| `dpi_paper` | 18.50 | 19.50 |" in levels(data)


def test_losses_name_scenes_and_by_how_much():
    """Ours is at 20 and 21 dB; the other 1.5 behind in the first scene, 2 ahead in the second."""
    other = rows_of("dpi_paper", 18.5, 1, scenes=("a",)) + rows_of("dpi_paper", 23, 1, ("b",))
    for row in other:
        row["scores"] = row["scores"] | {"relight_psnr_channel": 19.5}
    text = losses({"rows": rows_of(OURS, 20, 5) + other})
    assert text.startswith(f"`{OURS}` is behind `dpi_paper` on 1 of 2 scenes: b by 2.0 dB")
    assert "(aligned +1.5)" in text and text.endswith("it is behind on 0.\n")
    assert "on 0 of 1 scenes. " in losses({"rows": rows_of(OURS, 20, 5) + other[:2]})


def test_views_are_paired_by_name():
    rows = rows_of(OURS, 20, 5, scenes=("a",))
    np.testing.assert_allclose(views_of(rows, "relight"), 20.5 + 0.1 * np.arange(4))


def test_bootstrap_interval_holds_the_mean_as_often_as_it_says():
    rng = numpy_rng(0)
    common = 5 * rng.normal(size=(200, 40))  # what both methods share drops out
    ours = common + rng.normal(size=common.shape)
    theirs = common + 0.5 + rng.normal(size=common.shape)
    found = [paired(a, b) for a, b in zip(theirs, ours)]
    held = np.mean([low <= 0.5 <= high for _, low, high in found])
    assert 0.88 <= held <= 0.98
    assert np.isnan(paired(np.ones(1), np.zeros(1))[1])


def test_a_lead_that_may_be_chance_is_said():
    ours = Point(OURS, 5, 20, 0, 0)
    clear, unclear_one = (Point("map", 9, 21, low, 2.0) for low in (0.5, 1.5))
    assert unclear([ours, clear]) == "" and unclear([clear]) == ""
    assert "1.0 dB (-0.5 to 3.0), may be chance" in unclear([ours, unclear_one])


def test_front_is_what_nothing_beats():
    make = lambda name, s, v: Point(name, s, v, 0, 0)
    points = [make("slow", 9, 20), make("fast", 1, 10), make("worse", 5, 9), make("same", 3, 10)]
    assert [p.method for p in front(points, True)] == ["fast", "slow"]
    assert [p.method for p in front(points, False)] == ["fast", "worse"]
    said = choice(points, True, " dB", "views under new light")
    assert "no choice yet" in choice(points[:1], True, " dB", "views under new light")
    assert "nothing can be said" in choice([], True, " dB", "views under new light")
    assert "`slow` (9.0 s, 20.0 dB) if its time is there, `fast` (1.0 s" in said


def test_times_are_of_the_rows_made_for_them(data):
    """They may be of fewer scenes; a method that they lack has scores and no time."""
    data["times"] = [r | {"scene": "a"} for r in rows_of(OURS, 0, 3) + rows_of("map", 0, 1)]
    assert seconds(data, OURS) == 6 and seconds(data, "dpi_paper") is None
    assert mean_of(data, OURS, "relight_psnr") == 20.5
    assert {p.method: p.seconds for p in relight_points(data)} == {OURS: 3, "map": 1}
    assert "On 1 scene `map` takes 0.3 times as long" in speed_against(data, "map")


def ink(figure) -> np.ndarray:
    """Pixels (h, w) that are not white."""
    figure.canvas.draw()
    return np.asarray(figure.canvas.buffer_rgba())[..., :3].min(-1) < 250


@pytest.mark.slow
@pytest.mark.parametrize("points, higher", [(relight_points, True), (coverage_points, False)])
def test_labels_of_the_committed_charts_cross_nothing(points, higher):
    """Their ink is where no line, bar or marker has any, and where no other label is."""
    data = suite_rows("S")
    figure = chart(points(data), higher, "", "", means(data) if higher else {})
    (axes,) = figure.axes
    boxes = [box_of(label) for label in axes.texts]
    for label in axes.texts:
        label.set_color((0, 0, 0, 0))
    drawn = ink(figure)

    for artist in [*axes.lines, *axes.collections, *axes.spines.values(), axes.xaxis, axes.yaxis]:
        artist.set_visible(False)
    for label in axes.texts:
        label.set_color("black")
        if label.arrow_patch is not None:
            label.arrow_patch.set_visible(False)
    written = ink(figure)
    pyplot.close(figure)
    assert drawn.sum() > 1000 and written.sum() > 100 * len(boxes)
    assert not (drawn & written).any()
    assert not any(one.overlaps(other) for one, other in combinations(boxes, 2))


def test_labels_in_a_column_do_not_cover_each_other():
    heights = apart([0.5, 0.5, 0.49, 0.9], [])
    assert heights[2] == 0.49 and heights[3] == 0.9
    assert min(np.diff(sorted(heights))) >= HEIGHT - 1e-9
    crowded = apart([0.97, 0.98, 0.99, 0.99], [])
    assert min(np.diff(sorted(crowded))) >= HEIGHT - 1e-9 and max(crowded) < 1
    assert crowded[0] == min(crowded)
    for heights in ([0.3, 0.31, 0.35], [0.3, 0.98, 0.99]):
        clear = apart(heights, [0.31, 0.96])
        assert min(np.diff(sorted(clear))) >= HEIGHT - 1e-9
        assert all(
            abs(height - line) >= HEIGHT / 2 - 1e-9 for height in clear for line in (0.31, 0.96)
        )


def test_speed_counts_refinement(data):
    assert "`dpi_paper` takes 12.0 times as long as `split_gibbs_draft`" in speed_against(
        data, "dpi_paper"
    )
    assert "no rows" in speed_against(data)
    data["rows"] += rows_of("dpi_paper_1000", 18, 150, scenes=("b",))
    data["rows"] += rows_of(OURS, 20, 500, scenes=("c",))  # another scene does not count
    assert speed_against(data).startswith("On 1 scene `dpi_paper_1000` takes 30.0 times")

    data["rows"] += rows_of("preset_draft", 20, 30, scenes=("b",))
    data["rows"] += rows_of("preset_draft_mean", 20, 90, scenes=("b",))
    said = speed_against(data)
    assert "5.0 times as long as `preset_draft`" in said and "_mean" not in said


@pytest.mark.slow
def test_one_draw_a_scene_makes_no_chart_of_coverage(data, tmp_path, capsys):
    charts(data | {"together": []}, tmp_path, "XS")
    assert {file.name for file in tmp_path.iterdir()} == {
        "study_xs_relight.png",
        "study_xs_relight.svg",
    }
    assert "no chart of coverage" in capsys.readouterr().out


def test_charts_are_the_same_for_the_same_rows(data, tmp_path):
    for run in ("one", "two"):
        (tmp_path / run).mkdir()
        charts(data, tmp_path / run, "XS")
    names = sorted(path.name for path in (tmp_path / "one").iterdir())
    ends = [f"study_xs_{what}.{end}" for what in ("coverage", "relight") for end in ("png", "svg")]
    assert names == ends
    for name in names:
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes()
    svg = (tmp_path / "one" / "study_xs_relight.svg").read_text()
    assert "dpi_paper" in svg and OURS in svg


def test_every_sampler_is_a_method_and_shares_what_is_not_its_own(tmp_path):
    scenes = {name: scene_for(name, str(tmp_path)) for name in METHODS}
    draft = scenes[OURS]
    for name, scene in scenes.items():
        assert scene.sample.method == METHODS[name].sampler
        if METHODS[name].shipped:
            whole = {"photos": str(tmp_path), "preset": METHODS[name].preset}
            assert scene == parse_scene(whole, name) and scene.choose.enabled
            continue
        for part in ("capture", "mesh", "atlas", "observe", "render", "fit", "refine"):
            assert getattr(scene, part) == getattr(draft, part), name
    assert draft.refine.gloss == "maps"  # as drawn: a method's own
    assert draft.sample.points == 170 and scenes["split_gibbs_standard"].sample.points == 250
    assert scenes["dpi_paper_1000"].sample.steps == 1000
    label = lambda method, light: scene_for(method, f"a/xs_vase__{light}").sample.label
    assert [label("dpi_code", light) for light in ("room_4", "sunny_1")] == ["indoor", "outdoor"]
    assert label("dpi_paper", "room_4") is None
    with pytest.raises(InputError, match="did you mean 'dpi_paper'"):
        methods_named(["dpi_papr"])


def test_a_study_goes_on_where_it_stopped(tmp_path, monkeypatch):
    """Rows that are there are not made again; a method that fails leaves its message, and the study
    says at its end that it is not whole."""
    ran = []
    rows = tmp_path / "rows" / "own"
    for scene in ("t", "s"):
        (tmp_path / "given" / scene / "truth").mkdir(parents=True)
        (tmp_path / "given" / scene / "truth" / "envmap.exr").touch()

    def process(command, **options):
        assert json.loads(command[command.index("--about") + 1]) == about
        method = command[command.index("--method") + 1]
        scene = command[command.index("--photos") + 1].rsplit("/", 1)[-1]
        ran.append((scene, method))
        failed = method == "map"
        if not failed:
            for seed in command[command.index("--seeds") + 1 :]:
                write_json(rows / scene / method / f"{seed}.json", {"seed": int(seed)})
        return type("Done", (), {"returncode": int(failed), "stderr": "out of luck"})

    monkeypatch.setattr(study, "prepare", lambda folder: None)
    monkeypatch.setattr(study.subprocess, "run", process)
    command = ["study", "--methods", f"{OURS},map", "--samples", "2", "--note", "busy"]
    command += ["--rows", str(tmp_path / "rows"), "--out", str(tmp_path)]
    command += ["--suite", "own", "--given", str(tmp_path / "given")]
    monkeypatch.setattr(sys, "argv", command)
    said = f"--suite own --given SCENES --methods {OURS},map --samples 2 --out FOLDER"
    about = {"suite": "own", "command": f"python -m benchmarks.study {said}", "note": "busy"}
    with pytest.raises(SystemExit, match="2 of 4 methods on scenes failed"):
        study.main()
    assert len(ran) == 4
    assert (tmp_path / "draws" / "s" / "map" / "failed.txt").read_text() == "out of luck"
    (rows / "t" / OURS / "1.json").unlink()
    ran.clear()
    with pytest.raises(SystemExit, match="2 of 4"):
        study.main()
    assert ran == [("t", OURS), ("s", "map"), ("t", "map")]
    command[2] = OURS
    study.main()
    assert len(ran) == 3
    found = suite_rows("own", rows.parent)
    assert [row["seed"] for row in found["rows"]] == [0, 1, 0, 1] and found["times"] == []
    shutil.copytree(rows.parent, tmp_path / "rows_times")
    assert suite_rows("own", rows.parent)["times"] == found["rows"]

    about["command"] = about["command"].replace("--out", "--first-seed 7 --out")
    about["command"] = about["command"].replace(f"{OURS},map", OURS)
    command += ["--first-seed", "7"]
    study.main()
    seeds = [row["seed"] for row in suite_rows("own", rows.parent)["rows"]]
    assert seeds == [0, 1, 7, 8, 0, 1, 7, 8]
    command[2] = "preset_draft_mean"
    with pytest.raises(InputError, match="--first-seed"):
        study.main()


def test_versions_are_compared_on_the_scenes_that_both_have(data):
    """The later version's rows lack a scene."""
    later = {"rows": [], "together": []}
    for row in data["rows"]:
        if row["scene"] == "b":
            scores = row["scores"] | {"relight_psnr": row["scores"]["relight_psnr"] + 0.5}
            later["rows"].append(row | {"scores": scores})
    mean, low, high = versions.difference(later, data, OURS, "relight_psnr")
    assert mean == pytest.approx(0.5) and np.isnan(low) and np.isnan(high)
    assert set(versions.scene_means(data, OURS, "relight_psnr")) == {"a", "b"}


def test_versions_are_tabulated_on_the_scenes_that_all_have(data, tmp_path, monkeypatch):
    """The former code lacks a scene; of another method no scene has rows of both versions."""
    monkeypatch.setattr(versions, "SEEDS", tmp_path)
    mine = [row for row in data["rows"] if row["method"] == OURS]
    for commit, scenes, gain in (("old", "a", 0.0), ("new", "ab", 0.25)):
        for row in mine:
            if row["scene"] in scenes:
                scores = {k: v + gain for k, v in row["scores"].items()}
                place = tmp_path / commit / "s" / row["scene"] / OURS
                place.mkdir(parents=True, exist_ok=True)
                seed = row["seed"] + 3
                write_json(place / f"{seed}.json", row | {"scores": scores, "seed": seed})
    further = versions.suite_rows
    study = lambda suite, rows=None: further(suite, rows) if rows else data
    monkeypatch.setattr(versions, "suite_rows", study)
    monkeypatch.setattr(versions, "COMPARED", (OURS,))
    lines = versions.tables("old", "new").splitlines()
    assert lines[0].startswith(f"| `{OURS}`, 1 scenes |")
    assert [line.split("|")[1].strip() for line in lines[2:4]] == [
        "former code (old), seeds 3 to 4",
        "later code (new), seeds 3 to 4",
    ]
    assert all(cell.strip().startswith(".25") for cell in lines[5].split("|")[2:-1])
    with pytest.raises(InputError, match="no scene has rows of map"):
        versions.table("map", "old", "new")


def test_given_scenes_have_truth_and_a_name_of_their_own(tmp_path):
    truth = tmp_path / "a" / "truth" / "envmap.exr"
    with pytest.raises(InputError, match="no scenes with truth"):
        scenes_of("own", tmp_path, tmp_path)
    truth.parent.mkdir(parents=True)
    truth.touch()
    (tmp_path / "b").mkdir()
    assert scenes_of("own", tmp_path, tmp_path) == [tmp_path / "a"]
    with pytest.raises(InputError, match="'S' is a suite"):
        scenes_of("S", tmp_path, tmp_path)
    with pytest.raises(InputError, match="no scene 'b'"):
        scenes_of("own", tmp_path, tmp_path, ["a", "b"])


def test_agreement_is_the_largest_difference_over_draws():
    of = lambda *values: dict(zip(("study", "score", "score_twice"), values))
    scores = [of(20.0, 20.01, 20.03), of(18.0, 17.97, 18.0)]
    rows = [{way: {"relight_psnr": v} for way, v in draw.items()} for draw in scores]
    assert "| relight PSNR | dB | 19.0 | .030 | .030 |" in table(rows)
    assert most(rows, "relight_psnr", "study", "score_twice") == pytest.approx(0.03)


def test_a_suite_without_rows_is_an_error(tmp_path):
    with pytest.raises(InputError, match="there are no rows"):
        suite_rows("S", tmp_path)


def test_pictures_have_a_row_for_the_truth_and_each_method(tmp_path):
    rng = numpy_rng(0)
    cells = [(rng.random((8, 16, 3)), "1.0 dB"), (rng.random((8, 8, 3)), "2.0 dB")]
    sizes = []
    for run, count in (("one", 2), ("two", 2), ("three", 3)):
        draw([(str(k), cells) for k in range(count)], tmp_path / f"{run}.jpg")
        with Image.open(tmp_path / f"{run}.jpg") as picture:
            sizes.append(picture.height)
    assert (tmp_path / "one.jpg").read_bytes() == (tmp_path / "two.jpg").read_bytes()
    assert sizes[2] > 1.3 * sizes[0]


def test_spread_and_error_of_draws_are_shown_inside_the_mask():
    """Root mean squares over the channels; white outside."""
    mask = np.array([[True, False]])
    light = lambda value: np.full((1, 2, 3), value)
    draws = [[light(-1.0), light(0.1)], [light(1.0), light(0.3)]]
    (name, spread), (_, error) = spread_rows(draws, [light(0.5), light(0.1)], mask)
    assert name == "spread"
    assert [text for _, text in spread] == ["1.4", "0.14"]
    assert [text for _, text in error] == ["0.5", "0.1"]
    for picture, _ in (spread[1], error[1]):
        assert picture[0, 1].tolist() == [1, 1, 1] != picture[0, 0].tolist()
