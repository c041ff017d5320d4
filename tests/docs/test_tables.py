"""Tables of the pages are those that the committed rows make."""

import json
import sys
from pathlib import Path

import pytest

from benchmarks.markdown import number
from benchmarks.study import store
from benchmarks.tables import __main__ as command
from benchmarks.tables import committed
from benchmarks.tables.pages import BETWEEN_MARKS, TABLES, filled, pages
from benchmarks.tables.pairs import not_better
from benchmarks.tables.real_sets import real_sets, real_sets_truth
from pipeline.base.errors import InputError


@pytest.fixture
def house(tmp_path, monkeypatch):
    """An empty project, which the tables take for their own."""
    monkeypatch.setattr(committed, "ROOT", tmp_path)
    monkeypatch.setattr(committed, "RESULTS", tmp_path / "benchmarks" / "results")
    (tmp_path / "docs").mkdir()
    (tmp_path / "README.md").write_text("<!-- table: garden_stages -->\nold\n<!-- end -->\nrest\n")
    return tmp_path


def commit(rows):
    """Rows by name, as the house's own."""
    committed.RESULTS.mkdir(parents=True)
    for name, some in rows.items():
        about = {"command": "make it", "commit": "abc", "machine": "two cores", "note": ""}
        file = committed.RESULTS / f"{name}.json"
        file.write_text(json.dumps(about | {"data": {"rows": some}}))


def in_table(text):
    """The lines of a table without what stands below it."""
    return [line for line in text.splitlines() if line.startswith("|")]


@pytest.mark.parametrize("page", pages(), ids=lambda page: page.name)
def test_pages_hold_the_tables_of_the_committed_rows(page):
    assert page.read_text(encoding="utf-8") == filled(page)


def test_every_table_stands_on_a_page():
    text = "".join(page.read_text(encoding="utf-8") for page in pages())
    assert {name for _, name, *_ in BETWEEN_MARKS.findall(text)} == set(TABLES)


@pytest.mark.slow
def test_every_file_of_rows_feeds_a_table(monkeypatch):
    read = set()
    reader = committed.read_json
    for module in (committed, store):
        monkeypatch.setattr(module, "read_json", lambda path: read.add(path) or reader(path))
    for make in TABLES.values():
        make()
    assert read == set(committed.RESULTS.rglob("*.*"))


@pytest.mark.parametrize("file", sorted(committed.RESULTS.glob("*.json")), ids=lambda f: f.stem)
def test_rows_say_what_made_them(file):
    about = committed.results(file.stem)
    assert set(about) == {"command", "commit", "machine", "note", "data"}
    assert all(about[key] for key in ("command", "commit", "machine", "data"))


@pytest.mark.parametrize("rows", [store.ROWS, store.times_beside(store.ROWS)], ids=lambda f: f.name)
def test_rows_of_the_study_say_what_made_them(rows):
    for file in rows.rglob("*.json"):
        row = committed.read_json(file)
        assert all(row[key] for key in ("machine", "commit", "command")), file
        assert "note" in row, file
        folder = store.suite_folder(rows, row["suite"]) / row["scene"] / row["method"]
        seed = row["seed"] if "seed" in row else Path(store.TOGETHER).stem
        assert file == folder / f"{seed}.json"


def test_numbers_are_printed_as_the_pages_have_them():
    printed = [number(*v) for v in ((0.784, 2), (-0.5, 2), (1, 2), (0.4,), (None,), (403.4,))]
    assert printed == [".78", "-.50", "1.00", "0.4", "", "403"]


def test_figures_in_which_the_other_is_better_or_equal_are_all_named(house):
    rows = {
        "pairs_split_gibbs": [{"scene": "a__b", "light_psnr": 15.0, "base_colour_rms": 0.1}],
        "pairs_dpi_paper": [{"scene": "a__b", "light_psnr": 15.04, "base_colour_rms": 0.2}],
        "garden_draws": [
            {"method": "split_gibbs", "held_out_psnr": 26.0},
            {"method": "dpi_paper", "held_out_psnr": 27.0},
        ],
    }
    commit(rows)
    body = not_better().splitlines()[2:]
    assert body == [
        "| a, b | light dB, a draw | 15.0 | 15.0 |",
        "| garden | held-out dB | 26.0 | 27.0 |",
    ]


def test_real_sets_stand_before_and_now(house):
    sample = {"psnr": 18.4, "metallic_share_above_half": 0.94, "roughness_median": 0.5}
    lego = {"scene": "lego", "unlit_psnr": 18.9, "lit_psnr": 18.4, "gain": -0.5, "charts": 1480}
    lego |= {"samples": [sample, sample], "truth": {"normal_error_median_degrees": 12.5}}
    failed = {"scene": "axe", "failed": "exit status 1"}
    now = lego | {"lit_psnr": 20.4, "gain": 1.5, "truth": {}}
    commit({"real_sets_before": [lego, failed], "real_sets": [now]})

    head, _, *body = [line.split(" | ") for line in in_table(real_sets())]
    assert {len(line) for line in body} == {len(head)}
    assert [line[:5] for line in body] == [
        ["| lego", "before", "18.90", "18.40", "-.50"],
        ["| lego", "now", "18.90", "20.40", "1.50"],
        ["| axe", "before", "exit status 1", "", ""],
        ["| mean of 1", "before", "18.90", "18.40", "-.50"],
        ["| mean of 1", "now", "18.90", "20.40", "1.50"],
    ]
    assert ".94, .94" in body[0] and "18.40, 18.40" in body[0]
    assert [line.split(" | ")[1] for line in in_table(real_sets_truth())[2:]] == ["before"]


def test_rows_are_taken_with_their_source_and_written_into_the_page(house, monkeypatch):
    data = {"machine": "two cores", "rows": [{"stage": "fit", "seconds": 34}]}
    (house / "rows.json").write_text(json.dumps(data))
    said_on_the_line = [
        "tables",
        "--take",
        str(house / "rows.json"),
        "garden_stages",
        "--command",
        "make it",
    ]
    monkeypatch.setattr(sys, "argv", [*said_on_the_line, "--commit", "abc"])
    command.main()
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
        command.main()
    assert not (house / "benchmarks").exists()


def test_a_table_that_nobody_makes_is_an_error(house):
    (house / "README.md").write_text("<!-- table: garden_stage -->\n<!-- end -->\n")
    with pytest.raises(InputError, match="did you mean 'garden_stages'"):
        filled(house / "README.md")
