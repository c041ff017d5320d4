"""Faults: what counts as the same result, and what a case does to a project. Whole runs after a
fault: tests/dag.
"""

import json

import pytest

from benchmarks.faults import cases
from benchmarks.faults.__main__ import all_cases, by_itself
from benchmarks.faults.chain import Chain
from tests.seeds import numpy_rng


@pytest.fixture
def chain(tmp_path):
    """A project with a few files in the places of results."""
    chain = Chain(tmp_path / "whole")
    fit = chain.work / "fit"
    fit.mkdir(parents=True)
    (chain.folder / "exports").mkdir()
    (fit / "fit.json").write_text(
        json.dumps({"psnr": 20.5, "seconds": 1.5, "a": [{"peak_gib": 2}]})
    )
    (fit / "light.exr").write_bytes(bytes(range(100)))
    (fit / ".files.json").write_text("{}")
    (chain.folder / "exports" / "toy.usda").write_text("#usda 1.0")
    (chain.folder / "exports" / "toy_report.html").write_text("<html>")
    return chain


def test_sums_ignore_what_a_run_has_cost_and_nothing_else(chain):
    before = chain.sums()
    assert set(before) == {"work/toy/fit/fit.json", "work/toy/fit/light.exr", "exports/toy.usda"}

    file = chain.work / "fit" / "fit.json"
    file.write_text(json.dumps({"psnr": 20.5, "seconds": 2.5, "a": [{"peak_gib": 3}]}))
    assert chain.sums() == before
    file.write_text(json.dumps({"psnr": 20.6, "seconds": 1.5, "a": [{"peak_gib": 2}]}))
    assert chain.sums() != before
    file.write_text('{"psnr')
    assert chain.sums() != before


def test_a_damaged_file_is_shorter_and_as_old_as_before(chain, tmp_path):
    start = cases.Start(chain, chain, 1.0)
    hit = set()
    for number in range(12):
        random = numpy_rng(number)
        copy, happened = cases.damage(start, tmp_path / str(number), random)
        before, after = chain.sums(), copy.sums()
        changed = [name for name in before if before[name] != after[name]]
        assert len(changed) == 1 and happened.startswith(changed[0])

        old = (chain.folder / changed[0]).stat()
        new = (copy.folder / changed[0]).stat()
        assert new.st_size < old.st_size and new.st_mtime_ns == old.st_mtime_ns
        hit |= {*changed}
    assert len(hit) == 3


def test_cases_have_names_of_their_own():
    found = [(kind, number) for kind, number, _ in all_cases(30)]
    assert len(found) == len(set(found)) == 4 * 30 + 17


def test_a_case_that_is_being_told_is_told_by_nobody_else(tmp_path):
    with by_itself(tmp_path / "a") as mine, by_itself(tmp_path / "a") as again:
        with by_itself(tmp_path / "b") as other:
            assert mine and other and not again
    with by_itself(tmp_path / "a") as mine:
        assert mine
