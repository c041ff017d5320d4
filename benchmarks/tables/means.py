"""The mean of a scene's samples beside the samples (benchmarks/mean_of_samples.py)."""

from __future__ import annotations

import numpy as np

from benchmarks.markdown import number, pipe_table
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
SUITES = {"means_s": "S", "means_w": "W", "means_pairs": "pairs"}  # files of rows
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


def of_suites() -> str:
    """Suites down, scores across."""
    body = []
    for file, suite in SUITES.items():
        rows = rows_of(file)
        count = len(rows[0]["samples"])
        name = f"{suite}, `{rows[0]['preset']}`, {len(rows)} scenes, {count} samples"
        body.append([name, *(cell(rows, score) for score in SCORES)])
    units = {"": ""} | {METRICS[s].unit: f", {METRICS[s].unit}" for s in SCORES if METRICS[s].unit}
    head = ["", *(METRICS[score].title + units[METRICS[score].unit] for score in SCORES)]
    return pipe_table(head, body) + "".join(source(file) for file in SUITES)


def of_photos() -> str:
    """Held-out dB of every set of photos."""
    body = []
    for row in rows_of(PHOTOS):
        samples = ", ".join(f"{sample['held_out_psnr']:.2f}" for sample in row["samples"])
        body.append([row["scene"], samples, f"{row['mean']['held_out_psnr']:.2f}"])
    return pipe_table(["set", "samples", "their mean"], body) + source(PHOTOS)


TABLES = {"means": of_suites, "means_photos": of_photos}
