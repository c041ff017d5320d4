"""Every table by its name, and the pages that they stand on."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

from benchmarks import (
    atlas_tables,
    ladder_tables,
    memory,
    parsimony_tables,
    surfaces_tables,
    trust_tables,
)
from benchmarks.anytime import tables as anytime_tables
from benchmarks.stability import limits as stability
from benchmarks.study import pages as study_pages
from benchmarks.tables import (
    committed,
    common_error,
    from_photos,
    hardening,
    means,
    pairs,
    priors,
    real_sets,
    scenes,
    tabletop,
)
from benchmarks.tables.committed import results, rows_of, source
from benchmarks.work import tables as work_tables
from pipeline.base.errors import InputError, nearest

BETWEEN_MARKS = re.compile(r"(<!-- table: (\w+) -->\n)(.*?)(<!-- end -->)", re.DOTALL)


def stability_cures(before: str, after: str) -> Callable[[], str]:
    """Points of the suite before and after what was cured, from two files of rows."""
    make = lambda: stability.cures(*(results(name)["data"] for name in (before, after)))
    return lambda: make() + source(before) + source(after)


def stability_table(make: Callable[[dict], str], file: str) -> Callable[[], str]:
    """A table of the stability suite, from its committed rows."""
    return lambda: make(results(file)["data"]) + source(file)


def parsimony(make: Callable[[list[dict]], str], file: str) -> Callable[[], str]:
    """A table of what the choose stage saves and costs, from its committed rows."""
    return lambda: make(rows_of(file)) + source(file)


def of_surfaces() -> dict[str, Callable[[], str]]:
    """Tables of meshes and their atlases."""
    return {
        "surfaces_choice": lambda: surfaces_tables.choice(results("surfaces")["data"]),
        "surfaces": lambda: surfaces_tables.table(results("surfaces")["data"]) + source("surfaces"),
        "atlas": lambda: atlas_tables.table(rows_of("atlas")) + source("atlas"),
    }


def of_assets() -> dict[str, Callable[[], str]]:
    """Tables of what assets are worth, what they cost, and how far they may be relied on."""
    return {
        "parsimony": parsimony(parsimony_tables.summary, "parsimony"),
        "parsimony_scenes": parsimony(parsimony_tables.by_scene, "parsimony"),
        "parsimony_s": parsimony(parsimony_tables.summary, "parsimony_s"),
        "parsimony_s_scenes": parsimony(parsimony_tables.by_scene, "parsimony_s"),
        "parsimony_photos": parsimony(parsimony_tables.summary, "parsimony_photos"),
        "parsimony_photos_sets": parsimony(parsimony_tables.by_scene, "parsimony_photos"),
        "parsimony_draws": parsimony(parsimony_tables.summary, "parsimony_draws"),
        "parsimony_draws_scenes": parsimony(parsimony_tables.by_scene, "parsimony_draws"),
        "coverage": parsimony(parsimony_tables.coverage_by_scene, "coverage"),
        "common_error": common_error.table,
        "ladder": lambda: ladder_tables.photos(rows_of("ladder")) + source("ladder"),
        "ladder_truth": lambda: (
            ladder_tables.truths(rows_of("ladder_truth")) + source("ladder_truth")
        ),
        "ladder_folds": lambda: (
            ladder_tables.truths(rows_of("ladder_folds")) + source("ladder_folds")
        ),
        "ladder_worst": lambda: ladder_tables.worst(rows_of("ladder_truth")),
        "trust_summary": lambda: trust_tables.summary(rows_of("trust")),
        "trust_examples": lambda: trust_tables.examples(rows_of("trust")) + source("trust"),
        "work_slopes": lambda: work_tables.slopes(results("work")["data"]),
        "anytime": lambda: anytime_tables.table(rows_of("anytime")) + source("anytime"),
        "memory": lambda: memory.table(rows_of("memory")) + source("memory"),
        "work_figures": lambda: work_tables.figures(results("work")["data"]) + source("work"),
    }


TABLES: dict[str, Callable[[], str]] = {
    **pairs.TABLES,
    **scenes.TABLES,
    **real_sets.TABLES,
    **priors.TABLES,
    **hardening.TABLES,
    **means.TABLES,
    **from_photos.TABLES,
    **tabletop.TABLES,
    **study_pages.TABLES,
    **{name: stability_table(make, "stability") for name, make in stability.TABLES.items()},
    "stability_s_limits": stability_table(stability.breaking_points, "stability_s"),
    "stability_s_ends": stability_table(stability.side_by_side, "stability_s"),
    "stability_cures": stability_cures("stability_before", "stability_after"),
    "stability_level": stability_cures("stability_level_before", "stability_level"),
    **of_surfaces(),
    **of_assets(),
}


def pages() -> list[Path]:
    """Pages that may hold tables."""
    return [committed.ROOT / "README.md", *sorted((committed.ROOT / "docs").glob("*.md"))]


def filled(page: Path) -> str:
    """The text of a page with every table made anew. InputError for a table that nobody makes."""

    def table(match: re.Match) -> str:
        start, name, _, end = match.groups()
        if name not in TABLES:
            raise InputError(f"there is no table '{name}'", page, nearest(name, TABLES))
        return f"{start}\n{TABLES[name]()}\n{end}"

    return BETWEEN_MARKS.sub(table, page.read_text(encoding="utf-8"))
