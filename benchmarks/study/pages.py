"""The study's tables and sentences on the pages, by the name between their marks, from the
committed rows.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection
from pathlib import Path

from benchmarks.study import agreement_table, versions, yardstick_tables
from benchmarks.study.front import coverage_choice, relight_choice, speed_against
from benchmarks.study.losses import losses
from benchmarks.study.methods import METHODS, YARDSTICKS
from benchmarks.study.store import PAIRS, ROWS, SUITE, suite_folder, suite_rows, times_beside
from benchmarks.study.tables import (
    by_scene,
    costs,
    declarations,
    differences,
    draws,
    levels,
    likeness,
    scores,
    timed,
)
from benchmarks.study.versions import SEEDS
from benchmarks.tables import committed


def source(data: dict, methods: Collection[str] = METHODS) -> str:
    """The line below a table: where the rows of these methods come from."""
    return said_of([row for row in data["rows"] if row["method"] in methods], ROWS)


def times_source(data: dict) -> str:
    """The line below a table of times."""
    return said_of(data["times"], times_beside(ROWS))


def seeds_source() -> str:
    """The line below the table of further seeds."""
    places = [path for path in sorted(SEEDS.iterdir()) if path.is_dir()]
    return "".join(said_of(suite_rows(SUITE, place)["rows"], place) for place in places)


def said_of(rows: list[dict], folder: Path) -> str:
    """Folder, commands, machines, commits and notes of rows."""
    said = lambda key: dict.fromkeys(row[key] for row in rows if row[key])
    # made in pieces, of some scenes each, which the rows say
    whole = lambda command: re.sub(r" --scenes [\w,]+(?= )", "", command)
    commands = ", ".join(f"`{command}`" for command in dict.fromkeys(map(whole, said("command"))))
    place = suite_folder(folder.relative_to(committed.RESULTS), rows[0]["suite"])
    link = f"[{place}](../benchmarks/results/{place}), a file for each row"
    made = "; ".join([commands, ", ".join(said("machine")), ", ".join(said("commit"))])
    return f"\n<sub>{link}: {made}. {' '.join(said('note'))}</sub>\n"


def chart_source(data: dict) -> str:
    """The line below a chart: where and when it was timed, how it is drawn, what to copy."""
    rows = [row for method in METHODS for row in timed(data, method)]
    said = lambda key: ", ".join(dict.fromkeys(row[key] for row in rows if row.get(key)))
    days = f"times of {said('date')}; " if said("date") else ""
    redraw = f"drawn by `python -m benchmarks.study.charts --suite {SUITE} --out docs`"
    copy = "To copy: `preset: draft` or `preset: standard` in the scene's configuration, or"
    return (
        f"<sub>{said('machine')}; {days}{redraw}. {copy} `sample: {{method: NAME}}` for a method "
        "that is no preset. A method's `_mean` is what an asset of three samples opens with: "
        "`samples: 3`, the default.</sub>\n"
    )


OF_ROWS: dict[str, Callable[[dict], str]] = {
    "study_scores": scores,
    "study_likeness": likeness,
    "study_draws": draws,
    "study_differences": differences,
    "study_by_scene": by_scene,
    "study_levels": levels,
    "study_costs": costs,
    "study_relight_choice": lambda data: f"{relight_choice(data)}\n\n{chart_source(data)}",
    "study_coverage_choice": lambda data: coverage_choice(data) + "\n",
    "study_yardsticks": lambda data: yardstick_tables.table(data) + source(data, YARDSTICKS),
    "study_yardsticks_ahead": yardstick_tables.losers,
    "study_losses": losses,
    "study_source": source,
    "study_speed": lambda data: speed_against(data) + "\n",
    "study_times_source": times_source,
}


OF_PAIRS: dict[str, Callable[[dict], str]] = {
    "pairs_scores": lambda data: scores(data) + source(data),
    "pairs_yardsticks": lambda data: yardstick_tables.table(data) + source(data, YARDSTICKS),
    "pairs_draws": draws,
    "pairs_by_scene": by_scene,
    "pairs_levels": levels,
    "pairs_losses": lambda data: losses(data, "dpi_paper_1000"),
}


def of_study(make: Callable[[dict], str], suite: str) -> Callable[[], str]:
    """A table of the committed rows of a suite."""
    return lambda: make(suite_rows(suite))


TABLES: dict[str, Callable[[], str]] = {
    **{name: of_study(make, SUITE) for name, make in OF_ROWS.items()},
    **{name: of_study(make, PAIRS) for name, make in OF_PAIRS.items()},
    "study_declarations": declarations,
    "study_seeds": lambda: versions.tables("f79453a", "478deb1") + seeds_source(),
    "study_agreement": lambda: (
        agreement_table.table(committed.rows_of("study_agreement"))
        + committed.source("study_agreement")
    ),
}
