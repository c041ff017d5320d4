"""Charts of a study: seconds against accuracy, with the Pareto front, as SVG and PNG.

python -m benchmarks.study.charts --suite XS --out docs
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter

from benchmarks.figures import STYLE, matplotlib, pyplot, saved
from benchmarks.study.front import (
    Point,
    coverage_choice,
    coverage_points,
    front,
    relight_choice,
    relight_points,
)
from benchmarks.study.methods import LENGTHS
from benchmarks.study.store import ROWS, suite_rows
from benchmarks.study.tables import scenes_in
from benchmarks.study.yardstick_tables import means
from pipeline.base.errors import run_stage

PAPER_SECONDS = 1188.0  # a sample of the paper on an A100 (its section 5), 19.8 minutes
COLORS = {"ours": "#b4500f", "others": "#28507d", "front": "#777777"}
LABEL_HEIGHT = 0.042  # share of the axes' height
BESIDE = {
    "split_gibbs_draft": "split_gibbs draft",
    "split_gibbs_standard": "standard",
    "split_gibbs_reference": "reference",
    "dpi_paper_10": "dpi_paper, 10 levels",
    "dpi_paper_30": "30",
    "dpi_paper": "100",
    "dpi_paper_300": "300",
    "dpi_paper_1000": "1000",
}
LEADER = {"arrowstyle": "-", "lw": 0.4, "color": "#777777", "shrinkB": 3, "relpos": (0, 0.5)}


def apart(heights: list[float]) -> list[float]:
    """Heights of the labels of points at `heights`, as shares of the axes: each at its point's or
    just above the label below it; all moved down where they would end above the axes.
    """
    out = list(heights)
    order = sorted(range(len(heights)), key=lambda k: heights[k])
    last = -np.inf
    for k in order:
        last = out[k] = max(heights[k], last + LABEL_HEIGHT)
    below = 1.0
    for k in reversed(order):
        below = out[k] = min(out[k], below - LABEL_HEIGHT)
    return out


def name_points(axes: Axes, points: list[Point]) -> None:
    """Names: of a sampler's runs, where there are several, beside each what it differs by; of the
    others in one column at the right, with a line to each.
    """
    shown = {point.method for point in points}
    joined = {name for names in LENGTHS.values() if len(shown & {*names}) > 1 for name in names}
    others = []
    for point in points:
        if point.method not in joined & BESIDE.keys():
            others.append(point)
            continue
        color = COLORS["ours" if point.method.startswith("split_gibbs") else "others"]
        where = {"xytext": (5, 5), "textcoords": "offset points", "fontsize": 7, "color": color}
        axes.annotate(BESIDE[point.method], (point.seconds, point.value), **where)

    low, high = axes.get_ylim()
    column = 1.5 * max(point.seconds for point in points)
    heights = apart([(p.value - low) / (high - low) for p in others])
    for point, height in zip(others, heights):
        at = (point.seconds, point.value)
        where = (column, low + height * (high - low))
        axes.annotate(point.method, at, where, fontsize=7, va="center", arrowprops=LEADER)


def join_lengths(axes: Axes, points: list[Point]) -> None:
    """A line from each sampler's shortest run to its longest."""
    of = {point.method: point for point in points}
    for names in LENGTHS.values():
        run = [of[name] for name in names if name in of]
        color = COLORS["ours" if names[0].startswith("split_gibbs") else "others"]
        seconds, values = [p.seconds for p in run], [p.value for p in run]
        axes.plot(seconds, values, "-", lw=1, alpha=0.5, color=color, zorder=1)


def draw(
    points: list[Point],
    higher: bool,
    label: str,
    title: str,
    out: Path,
    yardsticks: dict[str, float] | None = None,
) -> None:
    """`out`.svg and `out`.png; a line across at the value of each of `yardsticks`."""
    with matplotlib.rc_context(STYLE):
        figure, axes = pyplot.subplots(figsize=(7, 4.2), layout="constrained")
        best = front(points, higher)
        steps = {"drawstyle": "steps-post", "color": COLORS["front"], "zorder": 1}
        axes.plot([p.seconds for p in best], [p.value for p in best], "--", lw=1, **steps)
        join_lengths(axes, points)
        for point in points:
            ours = point.method.startswith("split_gibbs")
            axes.errorbar(
                point.seconds,
                point.value,
                yerr=[[point.low], [point.high]],
                fmt="o" if ours else "s",
                color=COLORS["ours" if ours else "others"],
                capsize=2,
                lw=1,
            )
        axes.axvline(PAPER_SECONDS, color=COLORS["front"], lw=1, ls=":")
        where = {"xytext": (-4, 4), "textcoords": "offset points", "rotation": 90, "ha": "right"}
        at = (PAPER_SECONDS, axes.get_ylim()[0])
        axes.annotate("the paper's time, on an A100", at, fontsize=7, va="bottom", **where)
        for name, value in (yardsticks or {}).items():
            axes.axhline(value, color=COLORS["front"], lw=0.8, ls="-.", zorder=0)
            where = {"xytext": (4, -3), "textcoords": "offset points", "va": "top"}
            least = min(point.seconds for point in points)
            axes.annotate(f"yardstick {name}", (least, value), fontsize=7, **where)
        axes.margins(0.08, 0.12)
        axes.set_xscale("log")
        name_points(axes, points)
        axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axes.set_xlabel("seconds per sample on two cores, refinement included")
        axes.set_ylabel(label)
        axes.set_title(title, fontsize=9, loc="left")
        saved(figure, out, dpi=130)


def charts(data: dict, out: Path, suite: str) -> None:
    """Both charts of a study under `out`, with lines across where the yardsticks are."""
    count = len(scenes_in(data))
    title = (
        f"suite {suite}, {count} scenes; dashed: nothing is both faster and better;\n"
        "lines: one sampler, runs of growing length"
    )
    file = lambda name: out / f"study_{suite.lower()}_{name}"
    label = "relight PSNR, dB (bars: 95 % of the difference from ours)"
    draw(relight_points(data), True, label, title, file("relight"), means(data))
    label = "error of the 80 % intervals' coverage"
    draw(coverage_points(data), False, label, title, file("coverage"))


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--suite", default="XS")
    parser.add_argument("--rows", type=Path, default=ROWS, help="the committed ones if not given")
    parser.add_argument("--out", type=Path, required=True)
    args = parser.parse_args()
    data = suite_rows(args.suite, args.rows)
    charts(data, args.out, args.suite)
    print(relight_choice(data))
    print(coverage_choice(data))


if __name__ == "__main__":
    run_stage(main)
