"""The mean of a method's draws, as an asset opens with it, and what its draws took together."""

from __future__ import annotations

from pathlib import Path

from benchmarks.study.methods import MEANT
from benchmarks.study.store import row_file
from pipeline.base.errors import InputError
from pipeline.base.files import read_json
from pipeline.render.renderer import Explanation
from pipeline.render.samples import Samples, mean_of


def mean_of_draws(method: str, kept: Path, rows: Path) -> tuple[Explanation, dict]:
    """Mean of the first MEANT draws of a scene and method, which lie in kept/<method>/<seed>, their
    rows in rows/<method>; and what its row says that took: the sums of the draws' costs, the
    largest memory, and the draws' date, for the times are of that day.

    Raises InputError where a draw or its row is missing.
    """
    places = [kept / method / str(seed) for seed in range(MEANT)]
    files = [row_file(rows.parent, rows.name, method, seed) for seed in range(MEANT)]
    for path in (*places, *files):
        if not path.exists():
            cure = f"make {MEANT} draws of {method} first; a row that is there makes none anew"
            raise InputError("a draw that the mean is made of is missing", path, cure)
    samples = Samples(places)
    mean = mean_of(samples, samples.weights)
    assert mean is not None  # there are draws enough
    found = [read_json(file) for file in files]
    facts = {key: found[0][key] for key in ("once", "date") if key in found[0]}
    costs = [row["cost"] for row in found]
    peak = max(row["peak_gib"] for row in found)
    return mean, {"cost": total(costs), "peak_gib": peak, **facts}


def total(costs: list[dict]) -> dict:
    """Sums of the draws' costs, part by part."""
    add = lambda part: {key: sum(cost[part][key] for cost in costs) for key in costs[0][part]}
    return {part: add(part) for part in costs[0]}
