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
MANY_BEFORE, MANY = "from_photos_many_before", "from_photos_many"
SPREAD = ("relight_psnr", "relight_psnr_channel")  # raw, and with each channel's level aligned
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


def table() -> str:
    """Scenes down, each with both surfaces, and their means."""
    body = []
    rows = rows_of(FILE)
    for row in rows:
        trust = nested(row, "trust", "chance_of_failure")
        cells = [number(nested(row, *keys), digits) for _, keys, digits in SURFACE]
        cells += [pair(held_out(row), 2)]
        cells += [pair(np.array(of_samples(row, s)), METRICS[s].digits) for s in SCORES]
        body.append([row["scene"], row["surface"], *cells, number(trust, 2)])
    for surface in (OWN, GIVEN):
        these = [row for row in rows if row["surface"] == surface]
        cells = [pair(np.mean([held_out(row) for row in these], axis=0), 2)]
        for score in SCORES:
            both = np.mean([of_samples(row, score) for row in these], axis=0)
            cells.append(pair(both, METRICS[score].digits))
        means = [f"**mean of {len(these)}**", surface, *[""] * len(SURFACE)]
        body.append([*means, *cells, ""])
    units = [METRICS[s].title + (f", {METRICS[s].unit}" if METRICS[s].unit else "") for s in SCORES]
    head = ["thing", "surface", *(name for name, _, _ in SURFACE), "held out, dB: unlit \\| lit"]
    return pipe_table([*head, *units, "chance of failure, by the report"], body) + source(FILE)


def of_many() -> str:
    """One thing's own surface before and after a change, each with more samples than a run has: how
    far they spread, beside what the change does.
    """
    body = []
    for file, when in ((MANY_BEFORE, "before"), (MANY, "now")):
        for row in rows_of(file):
            shown = [[s[score] for s in row["truth"]["samples"]] for score in SPREAD]
            mean = row["truth"]["mean"]
            body.append(
                [
                    row["scene"],
                    when,
                    number(nested(row, "geometry", "normal_error_median_degrees"), 1),
                    pair(held_out(row), 2),
                    *(number(mean[score], 1) for score in SPREAD),
                    *(", ".join(number(v, 1) for v in values) for values in shown),
                ]
            )
    head = ["thing", "", "normals: median degrees", "held out, dB: unlit \\| lit"]
    head += ["mean relit, dB", "with levels aligned", "samples relit", "with levels aligned"]
    return pipe_table(head, body) + source(MANY_BEFORE) + source(MANY)


TABLES = {"from_photos": table, "from_photos_many": of_many}
