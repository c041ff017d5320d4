"""What runs that are stopped early are worth, as a table."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from benchmarks.markdown import number, pipe_table
from benchmarks.study.methods import METHODS

CORES = 2  # draws at a time, as in the study


@dataclass(frozen=True)
class Point:
    """A stop, means over scenes: `share` of the run's stops, seconds on two cores, scores by
    name.
    """

    share: float
    seconds: float
    scores: dict[str, float]


def scenes_in(rows: list[dict]) -> list[str]:
    return sorted({row["scene"] for row in rows})


def methods_in(rows: list[dict]) -> list[str]:
    """Those with a run of every scene, in the study's order."""
    scenes = scenes_in(rows)
    of = lambda name: {row["scene"] for row in rows if row["method"] == name}
    return [name for name in METHODS if len(of(name)) == len(scenes)]


def points(rows: list[dict], method: str) -> list[Point]:
    """A method's curve, from its first scored stop to the whole run."""
    runs = [row["stops"] for row in rows if row["method"] == method]
    return [point(stops) for stops in zip(*runs, strict=True)]


def point(stops: tuple[dict, ...]) -> Point:
    """The same stop of several scenes' runs."""
    seconds = np.mean([stop["cpu_seconds"] for stop in stops]) / CORES
    scores = {
        name: float(np.mean([stop["scores"][name] for stop in stops]))
        for name in stops[0]["scores"]
    }
    return Point(stops[0]["stop"] / stops[0]["count"], float(seconds), scores)


def table(rows: list[dict]) -> str:
    """Every scored stop of every method."""
    body = []
    for method in methods_in(rows):
        for at in points(rows, method):
            s = at.scores
            cells = [f"`{method}`", f"{at.share:.0%}", number(at.seconds, 1)]
            cells += [
                number(s[k], 1) for k in ("relight_psnr", "novel_view_psnr", "light_psnr_log")
            ]
            body.append([*cells, number(s["albedo_mse"], 4)])
    head = ["method", "of its stops", "s on two cores", "relight dB", "new views dB"]
    return pipe_table([*head, "light dB", "albedo MSE"], body)
