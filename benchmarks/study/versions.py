"""What a later version makes of a suite, beside the study's rows of the same methods.

A study's rows are of one day as far as they go, for times are compared by day. Rows in LATER are of
a version since then, and stand beside the study's own of the same scenes.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from benchmarks.markdown import number, pipe_table
from benchmarks.study.intervals import paired
from benchmarks.study.tables import (
    drawn,
    heading,
    methods_in,
    rows_for,
    scene_mean,
    scenes_in,
    with_interval,
)
from benchmarks.tables.committed import RESULTS
from pipeline.render.declared import METRICS

LATER = RESULTS / "study_later"
FEWEST = 8  # scenes that a method is compared on, at least
COMPARED = (
    "relight_psnr",
    "relight_psnr_channel",
    "novel_view_psnr",
    "light_psnr_log",
    "albedo_mse",
    "albedo_mse_scalar",
    "roughness_mse",
    "metallic_mse",
    "crps_relight",
    "crps_albedo",
)
NOMINAL = "80%"

Value = Callable[[dict, str, str], float | None]  # of rows, scene and method


def versions(before: dict, now: dict) -> str:
    """Both versions' means of every score over the scenes that both have, "before | now", and the
    difference, paired by scene, with its bootstrap interval; last, what 80 % intervals hold.
    """
    methods = [method for method in methods_in(now) if len(shared(before, now, method)) >= FEWEST]
    head = ["", *(f"`{method}`, {len(shared(before, now, method))} scenes" for method in methods)]
    body = []
    for key in COMPARED:
        value: Value = lambda data, scene, method, key=key: scene_mean(data, scene, method, key)
        digits = max(METRICS[key].digits, 2)
        body.append([heading(key), *(cell(before, now, m, value, digits) for m in methods)])
    held = [f"{NOMINAL.replace('%', ' %')} intervals hold"]
    return pipe_table(head, [*body, held + [cell(before, now, m, share, 2) for m in methods]])


def shared(before: dict, now: dict, method: str) -> list[str]:
    """Scenes of which both have rows by a method."""
    return [
        scene
        for scene in scenes_in(now)
        if rows_for(before, scene, method) and rows_for(now, scene, method)
    ]


def share(data: dict, scene: str, method: str) -> float | None:
    """Share of the true values that intervals of the draws hold, mean over kinds of unknowns."""
    held = drawn(data, scene, method)
    if "coverage" not in held:
        return None
    return float(np.mean([of_kind[NOMINAL] for of_kind in held["coverage"].values()]))


def cell(before: dict, now: dict, method: str, value: Value, digits: int) -> str:
    """Means "before | now" and the difference with its interval; empty where a value is missing."""
    pairs = [
        (value(before, scene, method), value(now, scene, method))
        for scene in shared(before, now, method)
    ]
    known = np.array([pair for pair in pairs if None not in pair], float)
    if len(known) < len(pairs):
        return ""
    then, later = (number(float(mean), digits) for mean in known.mean(0))
    return f"{then} \\| {later}: {with_interval(paired(known[:, 1], known[:, 0]), digits)}"
