"""Tables of the pages are those that the committed rows make."""

import json
import sys

import pytest

from benchmarks import tables
from pipeline.base.errors import InputError


@pytest.fixture
def house(tmp_path, monkeypatch):
    """An empty project of which tables.py believes that it is its own."""
    monkeypatch.setattr(tables, "ROOT", tmp_path)
    monkeypatch.setattr(tables, "RESULTS", tmp_path / "benchmarks" / "results")
    (tmp_path / "docs").mkdir()
    (tmp_path / "README.md").write_text("<!-- table: garden_stages -->\nold\n<!-- end -->\nrest\n")
    return tmp_path


@pytest.mark.parametrize("page", tables.pages(), ids=lambda page: page.name)
def test_pages_hold_the_tables_of_the_committed_rows(page):
    assert page.read_text(encoding="utf-8") == tables.filled(page)


def test_every_table_stands_on_a_page():
    text = "".join(page.read_text(encoding="utf-8") for page in tables.pages())
    assert {name for _, name, *_ in tables.BETWEEN_MARKS.findall(text)} == set(tables.TABLES)


@pytest.mark.slow
def test_every_file_of_rows_feeds_a_table(monkeypatch):
    read, results = set(), tables.results
    monkeypatch.setattr(tables, "results", lambda name: read.add(name) or results(name))
    for make in tables.TABLES.values():
        make()
    assert read == {path.stem for path in tables.RESULTS.iterdir()}


@pytest.mark.parametrize("file", sorted(tables.RESULTS.iterdir()), ids=lambda file: file.stem)
def test_rows_say_what_made_them(file):
    about = tables.results(file.stem)
    assert set(about) == {"command", "commit", "machine", "note", "data"}
    assert all(about[key] for key in ("command", "commit", "machine", "data"))


def test_numbers_are_printed_as_the_pages_have_them():
    printed = [
        tables.number(*v) for v in ((0.784, 2), (-0.5, 2), (1, 2), (0.4,), (None,), (403.4,))
    ]
    assert printed == [".78", "-.50", "1.00", "0.4", "", "403"]


def test_figures_in_which_the_other_is_better_or_equal_are_all_named(monkeypatch):
    rows = {
        "pairs_split_gibbs": [{"scene": "a__b", "light_psnr": 15.0, "base_colour_rms": 0.1}],
        "pairs_dpi_paper": [{"scene": "a__b", "light_psnr": 15.04, "base_colour_rms": 0.2}],
        "garden_draws": [
            {"method": "split_gibbs", "held_out_psnr": 26.0},
            {"method": "dpi_paper", "held_out_psnr": 27.0},
        ],
    }
    monkeypatch.setattr(tables, "rows_of", rows.__getitem__)
    body = tables.not_better().splitlines()[2:]
    assert body == [
        "| a, b | light dB, a draw | 15.0 | 15.0 |",
        "| garden | held-out dB | 26.0 | 27.0 |",
    ]


def test_real_sets_stand_before_and_now(house, monkeypatch):
    sample = {"metallic_median": 0.94, "roughness_median": 0.5}
    lego = {"scene": "lego", "unlit_psnr": 18.9, "lit_psnr": 18.4, "gain": -0.5, "charts": 1480}
    lego |= {"samples": [sample, sample], "truth": {"normal_error_median_degrees": 12.5}}
    failed = {"scene": "axe", "failed": "exit status 1"}
    now = lego | {"lit_psnr": 20.4, "gain": 1.5, "truth": {}}
    (tables.RESULTS / "real_sets.json").parent.mkdir(parents=True)
    (tables.RESULTS / "real_sets.json").touch()
    rows = {"real_sets_before": [lego, failed], "real_sets": [now]}
    monkeypatch.setattr(tables, "rows_of", rows.__getitem__)
    monkeypatch.setattr(tables, "source", lambda name: "")

    head, _, *body = [line.split(" | ") for line in tables.real_sets().splitlines()]
    assert {len(line) for line in body} == {len(head)}
    assert [line[:5] for line in body] == [
        ["| lego", "before", "18.9", "18.4", "-0.5"],
        ["| lego", "now", "18.9", "20.4", "1.5"],
        ["| axe", "before", "exit status 1", "", ""],
        ["| mean of 1", "before", "18.9", "18.4", "-0.5"],
        ["| mean of 1", "now", "18.9", "20.4", "1.5"],
    ]
    assert ".94, .94" in body[0]
    assert [line.split(" | ")[1] for line in tables.real_sets_truth().splitlines()[2:]] == [
        "before"
    ]


def test_rows_are_taken_with_their_source_and_written_into_the_page(house, monkeypatch):
    data = {"machine": "two cores", "rows": [{"stage": "fit", "seconds": 34}]}
    (house / "rows.json").write_text(json.dumps(data))
    command = [
        "tables",
        "--take",
        str(house / "rows.json"),
        "garden_stages",
        "--command",
        "make it",
    ]
    monkeypatch.setattr(sys, "argv", [*command, "--commit", "abc"])
    tables.main()
    about = json.loads((house / "benchmarks" / "results" / "garden_stages.json").read_text())
    said = {"command": "make it", "commit": "abc", "machine": "two cores", "note": "", "data": data}
    assert about == said
    page = (house / "README.md").read_text()
    assert "| fit |\n| --- |\n| 34 |" in page and "`make it`; two cores; abc." in page
    assert "old" not in page and page.endswith("<!-- end -->\nrest\n")


@pytest.mark.parametrize("said, missing", [([], "command"), (["--command", "make it"], "machine")])
def test_rows_without_their_source_are_refused(house, monkeypatch, said, missing):
    (house / "rows.json").write_text("{}")
    take = ["tables", "--take", str(house / "rows.json"), "pairs", *said]
    monkeypatch.setattr(sys, "argv", take)
    with pytest.raises(InputError, match=f"rows without their {missing}"):
        tables.main()
    assert not (house / "benchmarks").exists()


def test_a_table_that_nobody_makes_is_an_error(house):
    (house / "README.md").write_text("<!-- table: garden_stage -->\n<!-- end -->\n")
    with pytest.raises(InputError, match="did you mean 'garden_stages'"):
        tables.filled(house / "README.md")
