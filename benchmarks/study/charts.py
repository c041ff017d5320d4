"""Charts of a study: seconds against accuracy, with the Pareto front, as SVG and PNG.

python -m benchmarks.study.charts --suite XS --out docs
"""

from __future__ import annotations

import argparse
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure
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
from benchmarks.study.labels import Labels
from benchmarks.study.methods import LENGTHS, is_ours
from benchmarks.study.store import ROWS, suite_rows
from benchmarks.study.tables import scenes_in
from benchmarks.study.yardstick_tables import means
from pipeline.base.errors import run_stage

PAPER_SECONDS = 1188.0  # a sample of the paper on an A100 (its section 5), 19.8 minutes
COLORS = {"ours": "#b4500f", "others": "#28507d", "front": "#777777"}
DPI = 130  # of the PNG
ROOM = 2.6  # left of the first point, for its label, where points are few: a factor of the seconds
BESIDE = {  # dpi_paper itself, of 100 levels, has no free place beside it
    "preset_draft": "preset draft",
    "preset_standard": "preset standard",
    "preset_draft_mean": "mean of 3, draft",
    "preset_standard_mean": "mean of 3, standard",
    "split_gibbs_draft": "split_gibbs draft",
    "split_gibbs_standard": "standard",
    "split_gibbs_reference": "reference",
    "dpi_paper_10": "10 levels",
    "dpi_paper_30": "30",
    "dpi_paper_300": "300",
    "dpi_paper_1000": "1000",
}


def joined(points: list[Point]) -> set[str]:
    """Methods that are runs of a sampler with several of them here, and named by their length."""
    shown = {point.method for point in points}
    runs = {name for names in LENGTHS.values() if len(shown & {*names}) > 1 for name in names}
    return shown & runs & BESIDE.keys()


def color_of(method: str) -> str:
    return COLORS["ours" if is_ours(method) else "others"]


def name_points(labels: Labels, points: list[Point], across: list[float]) -> None:
    """Names: of a sampler's runs, where there are several, beside each what it differs by; of the
    others in one column at the right, with a line to each. across: heights of lines across.
    """
    for point in points:
        labels.keep_free((point.seconds, point.value))
    runs = joined(points)
    others = [point for point in points if point.method not in runs]
    column = 2 * max(point.seconds for point in points)
    at = [(point.seconds, point.value) for point in others]
    labels.column([point.method for point in others], at, column, across)
    for point in points:
        if point.method in runs:
            place = (point.seconds, point.value)
            labels.beside(BESIDE[point.method], place, color_of(point.method))


def join_lengths(axes: Axes, points: list[Point]) -> None:
    """A line from each sampler's shortest run to its longest."""
    of = {point.method: point for point in points}
    for names in LENGTHS.values():
        run = [of[name] for name in names if name in of]
        if len(run) < 2:
            continue
        seconds, values = [p.seconds for p in run], [p.value for p in run]
        axes.plot(seconds, values, "-", lw=1, alpha=0.5, color=color_of(names[0]), zorder=1)


def draw_points(axes: Axes, points: list[Point]) -> None:
    """Each with its interval."""
    for point in points:
        axes.errorbar(
            point.seconds,
            point.value,
            yerr=[[point.low], [point.high]],
            fmt="o" if is_ours(point.method) else "s",
            color=color_of(point.method),
            capsize=2,
            lw=1,
        )


def draw_front(axes: Axes, points: list[Point], higher: bool) -> None:
    """Steps through the points that nothing beats."""
    best = front(points, higher)
    steps = {"drawstyle": "steps-post", "color": COLORS["front"], "zorder": 1}
    axes.plot([p.seconds for p in best], [p.value for p in best], "--", lw=1, **steps)


def chart(
    points: list[Point], higher: bool, label: str, title: str, yardsticks: dict[str, float]
) -> Figure:
    """Points with their front, and a line across at the value of each of `yardsticks`; an error,
    of which less is better, is shown from 0 on.
    """
    figure, axes = pyplot.subplots(figsize=(7, 4.2), layout="constrained")
    axes.set_xscale("log")
    draw_front(axes, points, higher)
    join_lengths(axes, points)
    draw_points(axes, points)
    axes.axvline(PAPER_SECONDS, color=COLORS["front"], lw=1, ls=":")
    for value in yardsticks.values():
        axes.axhline(value, color=COLORS["front"], lw=0.8, ls="-.", zorder=0)
    axes.margins(0.08, 0.12)
    if not higher:
        axes.set_ylim(bottom=0)
        axes.set_xlim(left=min(point.seconds for point in points) / ROOM)
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.set_xlabel(
        "seconds on two cores, refinement included: of a sample, or of the three of a mean"
    )
    axes.set_ylabel(label)
    axes.set_title(title, fontsize=9, loc="left")

    labels = Labels(axes)
    labels.along("the paper's time, on an A100", PAPER_SECONDS)
    name_points(labels, points, list(yardsticks.values()))
    for name, value in yardsticks.items():
        labels.beside(f"yardstick {name}", (PAPER_SECONDS, value), "black")
    return figure


def charts(data: dict, out: Path, suite: str) -> None:
    """Both charts of a study under `out`, with lines across where the yardsticks are; where no
    method has several draws of every scene, the first one alone.
    """
    count = len(scenes_in(data))
    title = (
        f"suite {suite}, {count} scenes; dashed: nothing is both faster and better;\n"
        "lines: one sampler, runs of growing length; numbers: levels of dpi_paper"
    )
    file = lambda name: out / f"study_{suite.lower()}_{name}"
    label = "relight PSNR, dB (bars: 95 % of the difference from ours)"
    with matplotlib.rc_context(STYLE):
        relight = chart(relight_points(data), True, label, title, means(data))
        saved(relight, file("relight"), dpi=DPI)
        label = "error of the 80 % intervals (bars: 95 % over scenes)"
        points = coverage_points(data)
        if points:
            saved(chart(points, False, label, title, {}), file("coverage"), dpi=DPI)
        else:
            print("no chart of coverage: no method has several draws of every scene")


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
