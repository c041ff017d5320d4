"""The study's tables and sentences on the pages, by the name between their marks."""

from __future__ import annotations

from collections.abc import Callable

from benchmarks.study.front import coverage_choice, relight_choice, speed_against
from benchmarks.study.tables import (
    by_scene,
    costs,
    declarations,
    differences,
    draws,
    levels,
    scores,
)

TABLES: dict[str, Callable[[dict], str]] = {
    "study_scores": scores,
    "study_draws": draws,
    "study_differences": differences,
    "study_by_scene": by_scene,
    "study_levels": levels,
    "study_costs": costs,
    "study_declarations": lambda data: declarations(),
    "study_relight_choice": lambda data: relight_choice(data) + "\n",
    "study_speed": lambda data: speed_against(data) + "\n",
    "study_coverage_choice": lambda data: coverage_choice(data) + "\n",
}
