"""The mean of a scene's samples beside the samples: of the study's rows where truth is known, of
benchmarks/mean_of_samples.py for photos.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import product

import numpy as np

from benchmarks.markdown import number, pipe_table
from benchmarks.study.store import PAIRS, SUITE, suite_rows
from benchmarks.study.tables import rows_for, scenes_in
from benchmarks.tables.committed import rows_of, source
from pipeline.render.declared import METRICS

SCORES = (
    "relight_psnr",
    "novel_view_psnr",
    "light_psnr_log",
    "albedo_mse",
    "roughness_mse",
    "metallic_mse",
)
PRESETS = ("draft", "standard")
AHEAD = "relight_psnr"  # by which scenes are counted
PHOTOS = "means_photos"


def pairs(rows: list[dict], score: str) -> np.ndarray:
    """(n, 2) of every scene: what a sample has, mean over them, and what their mean has."""
    of_samples = [np.mean([sample[score] for sample in row["samples"]]) for row in rows]
    return np.column_stack([of_samples, [row["mean"][score] for row in rows]])


def cell(rows: list[dict], score: str) -> str:
    """A sample | their mean, with the difference and its standard error over scenes."""
    digits = METRICS[score].digits
    found = pairs(rows, score)
    a, b = (number(value, digits) for value in found.mean(0))
    ahead = found[:, 1] - found[:, 0]
    error = ahead.std(ddof=1) / np.sqrt(len(ahead))
    return f"{a} \\| {b} ({ahead.mean():+.{digits}f} ± {error:.{digits}f})"


def of_study(data: dict, preset: str) -> list[dict]:
    """A row of each scene of a study: scores of its `samples` by a preset, and of their `mean`."""
    scores = lambda scene, method: [row["scores"] for row in rows_for(data, scene, method)]
    return [
        {"samples": scores(scene, f"preset_{preset}"), "mean": mean}
        for scene in scenes_in(data)
        for mean in scores(scene, f"preset_{preset}_mean")
    ]


def ahead(rows: list[dict], of: Callable[[list[float]], float]) -> str:
    """On how many scenes the mean relights better than `of` its samples."""
    wins = [row["mean"][AHEAD] > of([sample[AHEAD] for sample in row["samples"]]) for row in rows]
    return f"{sum(wins)} of {len(wins)}"


def of_suites() -> str:
    """Suites and presets down, scores across."""
    body = []
    found = {suite: suite_rows(suite) for suite in (SUITE, PAIRS)}
    for suite, preset in product(found, PRESETS):
        rows = of_study(found[suite], preset)
        name = f"{suite}, `{preset}`, {len(rows)} scenes, {len(rows[0]['samples'])} samples"
        wins = [ahead(rows, lambda values: float(np.mean(values))), ahead(rows, max)]
        body.append([name, *(cell(rows, score) for score in SCORES), *wins])
    units = {"": ""} | {METRICS[s].unit: f", {METRICS[s].unit}" for s in SCORES if METRICS[s].unit}
    head = ["", *(METRICS[score].title + units[METRICS[score].unit] for score in SCORES)]
    head += ["relights better than its samples on average", "than the best of them"]
    return pipe_table(head, body)


def of_photos() -> str:
    """Held-out dB of every set of photos."""
    body = []
    for row in rows_of(PHOTOS):
        samples = ", ".join(f"{sample['held_out_psnr']:.2f}" for sample in row["samples"])
        body.append([row["scene"], samples, f"{row['mean']['held_out_psnr']:.2f}"])
    return pipe_table(["set", "samples", "their mean"], body) + source(PHOTOS)


TABLES = {"means": of_suites, "means_photos": of_photos}
