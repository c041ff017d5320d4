"""The study's figures beside those of `heliograph score` on the same draws, as a table."""

from __future__ import annotations

import numpy as np

from benchmarks.markdown import number, pipe_table
from pipeline.render.declared import METRICS


def most(rows: list[dict], key: str, one: str, other: str) -> float:
    """The largest difference of a score between two ways to it."""
    return max(abs(row[one][key] - row[other][key]) for row in rows)


def table(rows: list[dict]) -> str:
    """Every score: the largest differences over all draws."""
    body = []
    for key in rows[0]["study"]:
        found = [number(float(np.mean([row["study"][key] for row in rows])), METRICS[key].digits)]
        for ways in (("study", "score"), ("score", "score_twice")):
            found.append(number(most(rows, key, *ways), METRICS[key].digits + 2))
        body.append([METRICS[key].title, METRICS[key].unit, *found])
    head = ["score", "unit", "mean", "study less `score` of the export, at most"]
    return pipe_table([*head, "`score` with twice the paths less that, at most"], body)
