"""Seconds against accuracy: points of the charts, their Pareto front, and what to choose."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from benchmarks.study.intervals import paired, resampled
from benchmarks.study.methods import METHODS, OURS, is_ours
from benchmarks.study.tables import (
    coverage_error,
    mean_of,
    methods_in,
    scene_mean,
    scenes_in,
    seconds,
    shares_held,
    timing,
)

CORES = 2  # draws are made on one thread each, two at a time


@dataclass
class Point:
    """A method in a chart: seconds of a row on two cores, its value, half its interval's ends."""

    method: str
    seconds: float
    value: float
    low: float
    high: float


def relight_points(data: dict) -> list[Point]:
    """Relight PSNR in dB, mean over scenes, with the bootstrap interval over scenes of the
    difference from ours: what scenes have in common drops out.
    """
    out = []
    scenes = scenes_in(data)
    for method in methods_in(data):
        mean, spent = mean_of(data, method, "relight_psnr"), seconds(data, method)
        if mean is None or spent is None:
            continue
        values = [scene_mean(data, scene, method, "relight_psnr") for scene in scenes]
        ours = [scene_mean(data, scene, OURS, "relight_psnr") for scene in scenes]
        reach = (0.0, 0.0)
        if None not in ours and method != OURS:
            middle, low, high = paired(np.array(values), np.array(ours))
            reach = (0.0, 0.0) if np.isnan(low) else (middle - low, high - middle)
        out.append(Point(method, spent / CORES, mean, *reach))
    return out


def coverage_points(data: dict) -> list[Point]:
    """Error of the 80 % intervals (`coverage_error`), with its bootstrap interval over scenes."""
    out = []
    for method in methods_in(data):
        shares, spent = shares_held(data, method), seconds(data, method)
        if shares is None or spent is None:
            continue
        error = float(coverage_error(shares))
        low, high = error_interval(shares) if len(shares) > 1 else (error, error)
        reach = max(error - low, 0.0), max(high - error, 0.0)
        out.append(Point(method, spent / CORES, error, *reach))
    return out


def error_interval(shares: np.ndarray) -> tuple[float, float]:
    """Bootstrap interval over scenes of the `coverage_error` of shares (scenes, kinds)."""
    return resampled(len(shares), lambda chosen: coverage_error(shares[chosen]))


def front(points: list[Point], higher: bool) -> list[Point]:
    """Those that no other one beats in both seconds and value, fastest first."""
    best: list[Point] = []
    sign = 1 if higher else -1
    for point in sorted(points, key=lambda p: (p.seconds, -sign * p.value)):
        if not best or sign * point.value > sign * best[-1].value:
            best.append(point)
    return best


def choice(points: list[Point], higher: bool, unit: str, what: str) -> str:
    """Which method to choose, in one sentence."""
    if not points:
        return f"For {what} nothing can be said yet: no method has rows for it in every scene."
    best = front(points, higher)
    say = lambda p: f"`{p.method}` ({p.seconds:.1f} s, {p.value:.{1 if unit else 2}f}{unit})"
    if len(points) == 1:
        return f"For {what} only {say(best[0])} has rows in every scene: there is no choice yet."
    if len(best) == 1:
        return f"For {what} choose {say(best[0])}: nothing here is faster, nor better."
    middle = f"; between them lie {', '.join(map(say, best[1:-1]))}" if len(best) > 2 else ""
    return (
        f"For {what} choose {say(best[-1])} if its time is there, {say(best[0])} if it is not"
        f"{middle}."
    )


def relight_choice(data: dict) -> str:
    points = relight_points(data)
    text = choice(points, True, " dB", "views under new light")
    return f"{text}{unclear(points)}"


def unclear(points: list[Point]) -> str:
    """A sentence where the best one's lead over ours may be chance: its interval holds 0."""
    ours = next((point for point in points if point.method == OURS), None)
    if ours is None:
        return ""
    best = front(points, True)[-1]
    lead = best.value - ours.value
    if best is ours or lead > best.low:
        return ""
    reach = f"{lead - best.low:.1f} to {lead + best.high:.1f}"
    return f" `{best.method}` less `{OURS}`, {lead:.1f} dB ({reach}), may be chance."


def coverage_choice(data: dict) -> str:
    points = coverage_points(data)
    text = choice(points, False, "", "intervals that hold what they promise")
    return f"{text}{as_good(data, points)}"


def as_good(data: dict, points: list[Point]) -> str:
    """A sentence that names the methods whose intervals are worse than the best one's by no more
    than chance: the bootstrap interval of the difference, paired by scene, holds 0.
    """
    if len(points) < 2:
        return ""
    best, *others = sorted(points, key=lambda point: point.value)
    near = [f"`{p.method}`" for p in others if error_ahead(data, best.method, p.method) <= 0]
    return f" That it is ahead of {', '.join(near)} may be chance." if near else ""


def error_ahead(data: dict, best: str, other: str) -> float:
    """By how much the error of the intervals of `best` is at least smaller than that of `other`:
    the lower end of the bootstrap interval, paired by scene; 0 for a single scene.
    """
    ours, theirs = shares_held(data, best), shares_held(data, other)
    assert ours is not None and theirs is not None  # a method in the chart has them
    if len(ours) < 2:
        return 0.0
    ahead = lambda chosen: coverage_error(theirs[chosen]) - coverage_error(ours[chosen])
    return resampled(len(ours), ahead)[0]


def is_draw_of_ours(method: str) -> bool:
    """Whether a method is one draw of our sampler, not a mean of several."""
    return is_ours(method) and not METHODS[method].mean_of


def speed_against(data: dict, slow: str = "dpi_paper_1000") -> str:
    """How many times as long as a draw of ours another method takes on the scenes it has rows of,
    refinement included, in one sentence.
    """
    rows = timing(data)
    scenes = {row["scene"] for row in rows if row["method"] == slow}
    same = {"rows": [row for row in rows if row["scene"] in scenes]}
    spent = {method: seconds(same, method) for method in methods_in(same)}
    ours = {m: s for m, s in spent.items() if s is not None and is_draw_of_ours(m)}
    theirs = spent.get(slow)
    if theirs is None or not ours:
        return f"`{slow}` has no rows yet whose times can be compared."
    times = [f"{theirs / mine:.1f} times as long as `{method}`" for method, mine in ours.items()]
    count = f"{len(scenes)} scene" + "s" * (len(scenes) > 1)
    *first, last = times
    said = f"{', '.join(first)}, and {last}" if first else last
    return f"On {count} `{slow}` takes {said}, refinement included."
