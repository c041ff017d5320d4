"""Cost against work: the scenes of a value, slopes, and runs that go on where they stopped."""

import sys

import pytest

from benchmarks import chain_runs
from benchmarks.stability.scenes import BASES, base_recipe
from benchmarks.suite.patches import assembled
from benchmarks.work import __main__ as work
from benchmarks.work import knobs
from benchmarks.work.charts import page
from benchmarks.work.knobs import KNOBS, MOST_VIEWS, SIZE, finer
from benchmarks.work.tables import curve, figures, longest, slope, slopes
from pipeline.base.errors import InputError
from pipeline.base.files import read_json, write_json


def row(knob: str, value: int, seconds: float, gib: float) -> dict:
    return {
        "knob": knob,
        "value": value,
        "core_seconds": seconds,
        "seconds": {"mesh": 3.0, "fit": 1.0, "sample": 6.0, "atlas": 0.0},
        "peak_gib": gib,
        "peak_gib_by_stage": {"mesh": gib, "fit": gib / 2},
    }


DATA = {"rows": [row("views", n, 2.0 * n, 1.5) for n in (128, 8, 16, 32)]}


def test_slopes_are_exponents_of_the_largest_values():
    """Time that grows as the photos' number, memory that does not, but for the least value."""
    rows = curve({"rows": [*DATA["rows"], row("views", 4, 1000.0, 9.0)]}, "views")
    assert [r["value"] for r in rows] == [4, 8, 16, 32, 128]
    assert slope(rows, "core_seconds") == pytest.approx(1)
    assert slope(rows, "peak_gib") == pytest.approx(0, abs=1e-9)
    assert "photos 1.00 (time)" in slopes(DATA)


def test_the_table_says_which_stages_take_most():
    assert longest(DATA["rows"][0]) == "sample 60%, mesh 30%, fit 10%"
    lines = figures(DATA).splitlines()
    assert lines[2].startswith("| photos | 8 | 16 | sample 60%")
    assert lines[-1].startswith("| photos | 128 | 256 |") and lines[-1].endswith("| 1.50 | mesh |")


def test_the_page_is_written_as_svg_and_png(tmp_path):
    page(DATA, tmp_path / "work")
    assert "slope 1.00" in (tmp_path / "work.svg").read_text()
    assert (tmp_path / "work.png").stat().st_size > 5000


@pytest.mark.parametrize("count", [1000, 10_000, 100_000])
def test_patches_are_cut_to_so_many_triangles(count):
    patches = base_recipe(BASES["vase"], SIZE).thing.patches()
    now = 2 * sum(a * b for a, b in (patch.cells for patch in patches))
    made = len(assembled(finer(patches, count / now)).faces)
    assert made == pytest.approx(count, rel=0.12)


def test_photos_are_taken_evenly(tmp_path, monkeypatch):
    """With their masks, and without a mesh."""
    frames = [
        {"file_path": f"images/{k}.png", "mask_path": f"masks/{k}.png"} for k in range(MOST_VIEWS)
    ]

    def rendered(recipe, folder):
        assert recipe.options.views == MOST_VIEWS
        for frame in frames:
            for file in frame.values():
                (folder / file).parent.mkdir(parents=True, exist_ok=True)
                (folder / file).write_text(file)
        write_json(folder / "transforms.json", {"w": 5, "frames": frames})

    monkeypatch.setattr(knobs, "rendered", rendered)
    folder = KNOBS["views"].scene(8, tmp_path)
    cameras = read_json(folder / "transforms.json")
    chosen = [f"images/{k}.png" for k in range(0, MOST_VIEWS, MOST_VIEWS // 8)]
    assert [frame["file_path"] for frame in cameras["frames"]] == chosen and cameras["w"] == 5
    assert sorted(p.name for p in (folder / "images").iterdir()) == sorted(
        name.removeprefix("images/") for name in chosen
    )
    assert len(list((folder / "masks").iterdir())) == 8 and not (folder / "mesh.ply").exists()


def test_metrics_are_those_of_stages_and_samples(tmp_path):
    for file, seconds in (
        ("fit/fit.json", 1),
        ("sample/0/sample.json", 2),
        ("sample/1/sample.json", 3),
        ("export.json", 4),
    ):
        write_json(tmp_path / file, {"seconds": seconds, "peak_gib": 1.0})
    write_json(tmp_path / "capture" / "photos.json", {"photos": []})
    found = work.stage_metrics(tmp_path)
    assert {s: [f["seconds"] for f in many] for s, many in found.items()} == {
        "export": [4],
        "fit": [1],
        "sample": [2, 3],
    }


def test_a_run_goes_on_where_it_stopped(tmp_path, monkeypatch):
    """A row that is there is not made again; what a cut-off run left is not counted."""
    asked = []

    def run(project, scene, settings, targets):
        assert not project.exists()
        asked.append(settings)
        write_json(project / "work" / "work" / "fit" / "fit.json", {"seconds": 1, "peak_gib": 2.0})
        return 7.0

    monkeypatch.setattr(work, "run_chain", run)
    monkeypatch.setitem(
        KNOBS, "samples", knobs.Knob("samples", (1, 2), base, KNOBS["samples"].settings)
    )
    write_json(tmp_path / "rows" / "samples_1.json", {"value": 1})
    (tmp_path / "projects" / "samples_2").mkdir(parents=True)
    monkeypatch.setattr(sys, "argv", ["x", "--knobs", "samples", "--out", str(tmp_path)])
    work.main()
    assert [settings["samples"] for settings in asked] == [2]
    made = read_json(tmp_path / "rows" / "samples_2.json")
    assert (made["core_seconds"], made["peak_gib"], made["seconds"]) == (7.0, 2.0, {"fit": 1})
    assert not (tmp_path / "projects" / "samples_2").exists()
    assert [r["value"] for r in work.gathered(tmp_path)["rows"]] == [1, 2]

    monkeypatch.setattr(sys, "argv", ["x", "--knobs", "vews", "--out", str(tmp_path)])
    with pytest.raises(InputError, match="no knob 'vews'"):
        work.main()
    with pytest.raises(InputError, match="no rows"):
        work.gathered(tmp_path / "elsewhere")


def base(value, out):
    return out / "scene"


@pytest.mark.slow
def test_a_failed_run_names_its_log(tmp_path, monkeypatch):
    monkeypatch.setattr(chain_runs, "ROOT", tmp_path / "nothing")
    with pytest.raises(InputError, match="the run failed"):
        chain_runs.run_chain(tmp_path, "x", {"photos": "x"}, ["exports/x.usda"])
    assert (tmp_path / "run.txt").exists()
