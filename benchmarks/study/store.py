"""The committed rows of the study: one small file a row, so that a run is made in pieces.

benchmarks/results/study/<suite>/<scene>/<method>/<seed>.json holds one draw's row; together.json
beside it what the draws of a scene and a method say together. Rows in study_times, laid out alike,
were made to be timed: every method one after another, on some of the scenes.
"""

from __future__ import annotations

from datetime import date
from pathlib import Path

from benchmarks.scenes import machine
from benchmarks.tables.committed import RESULTS, head_commit
from pipeline.base.errors import InputError
from pipeline.base.files import read_json

ROWS = RESULTS / "study"
TOGETHER = "together.json"
SUITE = "S"  # the one that the pages show
PAIRS = "pairs"  # what rows of the scenes of benchmarks.pairs are called


def made_here() -> dict[str, str]:
    """What a row says of where and when it was made: `machine`, `commit`, `date`."""
    return {"machine": machine(), "commit": head_commit(), "date": date.today().isoformat()}


def suite_folder(rows: Path, suite: str) -> Path:
    """Where the rows of a suite lie."""
    return rows / suite.lower()


def row_file(folder: Path, scene: str, method: str, seed: int) -> Path:
    """A row of the suite whose rows lie in `folder`."""
    return folder / scene / method / f"{seed}.json"


def seeds_in(folder: Path) -> list[int]:
    """Seeds that a scene and method have rows of, in their folder; none where it is missing."""
    return sorted(int(file.stem) for file in folder.glob("*.json") if file.name != TOGETHER)


def suite_rows(suite: str, rows: Path = ROWS) -> dict:
    """`rows` of a suite, in the order of their scenes, methods and seeds, what draws say
    `together`, and `times`: the rows made to be timed, if any. Raises InputError without `rows`.
    """
    folder = suite_folder(rows, suite)
    places = places_in(folder)
    found = rows_in(places)
    if not found:
        raise InputError("there are no rows", folder, "run the study without --tables first")
    together = [place / TOGETHER for place in places if (place / TOGETHER).exists()]
    times = rows_in(places_in(suite_folder(times_beside(rows), suite)))
    return {"rows": found, "together": [read_json(file) for file in together], "times": times}


def times_beside(rows: Path) -> Path:
    """Where rows that were made to be timed lie: study_times, beside study."""
    return rows.with_name(f"{rows.name}_times")


def places_in(folder: Path) -> list[Path]:
    """Folders of a scene and a method, in order."""
    return sorted(place for place in folder.glob("*/*") if place.is_dir())


def rows_in(places: list[Path]) -> list[dict]:
    return [read_json(place / f"{seed}.json") for place in places for seed in seeds_in(place)]
