"""What intervals hold when they count an error that all draws have in common."""

from __future__ import annotations

import numpy as np

from benchmarks.markdown import pipe_table
from benchmarks.study.store import PAIRS, SUITE, suite_rows
from benchmarks.study.together import COMMON
from benchmarks.tables.committed import rows_of
from pipeline.render.draw_metrics import COMMON_ERROR

LEVEL = "80%"
OTHERS = ("50%", "95%")


def of_study(suite: str) -> dict[str, list[dict]]:
    """By method, what intervals of each scene of a study's suite hold; rows that say it."""
    found: dict[str, list[dict]] = {}
    for row in suite_rows(suite)["together"]:
        if "within" in row["scores"]:
            found.setdefault(row["method"], []).append(row["scores"]["within"])
    return {f"{suite}, `{method}`": held for method, held in found.items()}


def of_refined() -> dict[str, list[dict]]:
    """The same of suite W's refined samples."""
    return {"W, refined, `standard`": [row["chosen"]["within"] for row in rows_of("coverage")]}


def mean_held(scenes: list[dict], common: float, level: str) -> float:
    """Mean over relit pixels and base colours, and over scenes."""
    return float(np.mean([held[str(common)][level] for one in scenes for held in one.values()]))


def table() -> str:
    """Suites and methods down; across, by the common error, what 80 % intervals hold, and what the
    other intervals hold at COMMON_ERROR.
    """
    body = [
        [name]
        + [f"{mean_held(scenes, common, LEVEL):.2f}" for common in COMMON]
        + [f"{mean_held(scenes, COMMON_ERROR, level):.2f}" for level in OTHERS]
        for name, scenes in (of_refined() | of_study(SUITE) | of_study(PAIRS)).items()
    ]
    head = ["suite and method", *(f"80 % hold, {common:g} in common" for common in COMMON)]
    head += [f"{level.replace('%', ' %')} hold, {COMMON_ERROR:g}" for level in OTHERS]
    return pipe_table(head, body)
