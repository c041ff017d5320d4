"""Tables of cost against work."""

from __future__ import annotations

import numpy as np

from benchmarks.markdown import number, pipe_table
from benchmarks.work.knobs import KNOBS

LARGE = 3  # largest values, of which the slope is taken
SHOWN = 3  # stages that take most


def curve(data: dict, knob: str) -> list[dict]:
    """Rows of a knob, from little to much."""
    return sorted((r for r in data["rows"] if r["knob"] == knob), key=lambda row: row["value"])


def knobs_in(data: dict) -> list[str]:
    """Those with two values at least."""
    return [name for name in KNOBS if len(curve(data, name)) > 1]


def slope(rows: list[dict], kind: str) -> float:
    """Exponent a of cost ~ value^a, least squares in logs over the largest values."""
    large = rows[-LARGE:]
    values, costs = (np.log([row[key] for row in large]) for key in ("value", kind))
    return float(np.polyfit(values, costs, 1)[0])


def longest(row: dict) -> str:
    """The stages that take most, with their share of all stages' time."""
    total = sum(row["seconds"].values())
    order = sorted(row["seconds"].items(), key=lambda item: -item[1])[:SHOWN]
    return ", ".join(f"{stage} {seconds / total:.0%}" for stage, seconds in order)


def figures(data: dict) -> str:
    """Every value's cost."""
    body = []
    for name in knobs_in(data):
        for row in curve(data, name):
            heaviest = max(row["peak_gib_by_stage"], key=row["peak_gib_by_stage"].__getitem__)
            cells = [KNOBS[name].title, f"{row['value']:,}", number(row["core_seconds"], 0)]
            cells += [longest(row), number(row["peak_gib"], 2), heaviest]
            body.append(cells)
    head = ["turned", "value", "core s", "stages that take most time", "peak GiB", "in"]
    return pipe_table(head, body)


def slopes(data: dict) -> str:
    """One line: the exponents."""
    parts = [
        f"{KNOBS[name].title} {slope(curve(data, name), 'core_seconds'):.2f} (time), "
        f"{slope(curve(data, name), 'peak_gib'):.2f} (memory)"
        for name in knobs_in(data)
    ]
    return "Exponents over the three largest values of each: " + "; ".join(parts) + ".\n"


TABLES = {"work_figures": figures, "work_slopes": slopes}
