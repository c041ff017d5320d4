"""One page of small multiples: relight PSNR of every method as each knob is turned, as SVG and PNG.

python -m benchmarks.stability.charts --rows benchmarks/results/stability.json --out docs
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from benchmarks.figures import STYLE, matplotlib, pyplot, rows_and_out, saved
from benchmarks.stability.knobs import KNOBS
from benchmarks.stability.limits import (
    FALL,
    bases_in,
    curve,
    knobs_in,
    leading,
    limit,
    methods_in,
    relight,
)
from benchmarks.stability.scenes import scene_name
from benchmarks.study.methods import OURS
from pipeline.base.errors import run_stage

COLUMNS = 6
COLORS = {
    OURS: "#b4500f",
    f"{OURS}_mean": "#e0a070",
    "preset_draft": "#8a1f4f",
    "preset_draft_mean": "#d06fa0",
    "map": "#28507d",
    "dpi_paper": "#3c7d28",
}
OTHER = "#777777"
COVERAGE = "#999999"


def draw_method(axes: Axes, rows: list[dict], places: list[int], color: str) -> None:
    """A method's curve, a cross where it was refused, a ring where it breaks first."""
    known = [(x, relight(row)) for x, row in zip(places, rows) if relight(row) is not None]
    axes.plot(*zip(*known), "o-", color=color, lw=1.2, ms=3) if known else None
    low = axes.get_ylim()[0]
    for x, row in zip(places, rows):
        if "refused" in row:
            axes.plot(x, low, "x", color=color, ms=7, clip_on=False)
    broken = limit(rows)
    if broken is not None and relight(broken) is not None:
        x = places[rows.index(broken)]
        axes.plot(x, relight(broken), "o", mfc="none", mec=color, ms=9, mew=1.2)


def draw_knob(axes: Axes, data: dict, base: str, name: str, span: tuple[float, float]) -> None:
    """A knob's panel."""
    knob = KNOBS[name]
    axes.set_ylim(*span)
    for method in methods_in(data):
        rows = curve(data, base, name, method)
        places = [knob.values.index(row["value"]) for row in rows]
        if not rows:
            continue
        draw_method(axes, rows, places, COLORS.get(method, OTHER))
        if method == leading(data):
            start = relight(rows[0])
            if start is not None:
                axes.axhline(start - FALL, color=COLORS[method], lw=0.6, ls=":")
            held = [(x, row["coverage"]) for x, row in zip(places, rows) if row.get("coverage")]
            if held:
                other = axes.twinx()
                other.plot(*zip(*held), "--", color=COVERAGE, lw=0.9)
                other.axhline(0.8, color=COVERAGE, lw=0.4)
                other.set(ylim=(0, 1), yticks=[])
                other.spines[:].set_visible(False)
    axes.set_xlim(-0.3, len(knob.values) - 0.7)
    axes.set_xticks(range(len(knob.values)), [f"{value:g}" for value in knob.values], fontsize=7)
    axes.tick_params("y", labelsize=7)
    axes.set_title(knob.title + (f", {knob.unit}" if knob.unit else ""), fontsize=8, loc="left")


def page(data: dict, base: str, out: Path) -> None:
    """`out`.svg and `out`.png: all knobs of a base scene."""
    names = knobs_in(data, base)
    known = [relight(row) for row in data["rows"] if row["base"] == base and relight(row)]
    span = np.floor(min(known)) - 0.5, np.ceil(max(known)) + 0.5
    lines = -(-len(names) // COLUMNS)
    with matplotlib.rc_context(STYLE):
        figure, grid = pyplot.subplots(
            lines,
            COLUMNS,
            figsize=(2.3 * COLUMNS, 1.75 * lines + 0.5),
            layout="constrained",
            squeeze=False,
            sharey=True,
        )
        for axes, name in zip(grid.ravel(), names):
            draw_knob(axes, data, base, name, span)
        for axes in grid.ravel()[len(names) :]:
            axes.set_visible(False)
        for method in methods_in(data):
            grid[0, 0].plot(
                [], [], "o-", ms=3, lw=1.2, color=COLORS.get(method, OTHER), label=method
            )
        grid[0, 0].plot([], [], "--", lw=0.9, color=COVERAGE, label="80 % hold, 0 to 1")
        figure.legend(loc="outside upper right", ncols=4, fontsize=8, frameon=False)
        title = "relight PSNR, dB, from harmless (left) to hard; ring: breaks; cross: refused"
        figure.suptitle(f"{title}; scene {base}", fontsize=9, x=0.01, ha="left")
        saved(figure, out, dpi=110)


def main() -> None:
    found, out = rows_and_out(__doc__)
    rows = found["rows"]
    for size in dict.fromkeys(row["size"] for row in rows):
        data = {"rows": [row for row in rows if row["size"] == size]}
        for base in bases_in(data):
            page(data, base, out / f"stability_{scene_name(size, base)}")


if __name__ == "__main__":
    run_stage(main)
