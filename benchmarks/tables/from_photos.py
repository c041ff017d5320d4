"""Things whose truth is known, from photos to views under new light, with their own surface and
with the true one (benchmarks/from_photos.py).
"""

from __future__ import annotations

import numpy as np

from benchmarks.from_photos import GIVEN, OWN
from benchmarks.markdown import number, pipe_table
from benchmarks.tables.committed import nested, rows_of, source
from pipeline.render.declared import METRICS

FILE = "from_photos"
CEILING = "ceiling"  # what own surfaces allow under new light (benchmarks/ceiling.py)
SCORES = ("relight_psnr", "light_psnr_log", "albedo_mse")  # a sample, mean over them | their mean
SURFACE: list[tuple[str, tuple[str, ...], int]] = [
    ("F-score at 1 %", ("geometry", "f1_at_1_percent_of_size"), 3),
    ("normals: median degrees", ("geometry", "normal_error_median_degrees"), 1),
]


def of_samples(row: dict, score: str) -> tuple[float, float]:
    """What a sample has, mean over them, and what their mean has."""
    return float(np.mean([s[score] for s in row["truth"]["samples"]])), row["truth"]["mean"][score]


def pair(values: np.ndarray, digits: int) -> str:
    """Two figures side by side."""
    return " \\| ".join(number(float(value), digits) for value in values)


def held_out(row: dict) -> np.ndarray:
    """(2,) dB of the plain textured mesh and of the samples."""
    return np.array([row["photos"]["unlit_psnr"], row["photos"]["lit_psnr"]])


def spread(row: dict) -> str:
    """How far samples lie apart under new light, dB."""
    found = [sample["relight_psnr"] for sample in row["truth"]["samples"]]
    return f"{number(min(found), 1)} to {number(max(found), 1)}"


def table() -> str:
    """Scenes down, each with both surfaces, and their means."""
    body = []
    rows = rows_of(FILE)
    ceiling = {row["scene"]: row["scores"]["relight_psnr"] for row in rows_of(CEILING)}
    for row in rows:
        trust = nested(row, "trust", "chance_of_failure")
        cells = [number(nested(row, *keys), digits) for _, keys, digits in SURFACE]
        cells += [pair(held_out(row), 2)]
        cells += [pair(np.array(of_samples(row, s)), METRICS[s].digits) for s in SCORES]
        most = ceiling.get(row["scene"]) if row["surface"] == OWN else None
        body.append(
            [row["scene"], row["surface"], *cells, spread(row), number(most, 1), number(trust, 2)]
        )
    for surface in (OWN, GIVEN):
        these = [row for row in rows if row["surface"] == surface]
        cells = [pair(np.mean([held_out(row) for row in these], axis=0), 2)]
        for score in SCORES:
            both = np.mean([of_samples(row, score) for row in these], axis=0)
            cells.append(pair(both, METRICS[score].digits))
        means = [f"**mean of {len(these)}**", surface, *[""] * len(SURFACE)]
        body.append([*means, *cells, "", "", ""])
    units = [METRICS[s].title + (f", {METRICS[s].unit}" if METRICS[s].unit else "") for s in SCORES]
    head = ["thing", "surface", *(name for name, _, _ in SURFACE), "held out, dB: unlit \\| lit"]
    head += [*units, "samples relit, dB", "the surface allows, dB"]
    head += ["chance of failure, by the report"]
    return pipe_table(head, body) + source(FILE) + source(CEILING)


TABLES = {"from_photos": table}
