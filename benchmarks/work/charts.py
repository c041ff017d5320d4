"""Cost against work as a page of small multiples: seconds above, memory below, as SVG and PNG.

python -m benchmarks.work.charts --rows benchmarks/results/work.json --out docs
"""

from __future__ import annotations

from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter

from benchmarks.figures import STYLE, matplotlib, pyplot, rows_and_out, saved
from benchmarks.work.knobs import KNOBS
from benchmarks.work.tables import curve, knobs_in, slope
from pipeline.base.errors import run_stage

KINDS = {"core_seconds": "processor seconds", "peak_gib": "peak memory, GiB"}
COLORS = {"core_seconds": "#b4500f", "peak_gib": "#28507d"}


def draw(axes: Axes, rows: list[dict], kind: str) -> None:
    """A panel on log axes, with its slope at the large end."""
    values, costs = [row["value"] for row in rows], [row[kind] for row in rows]
    axes.plot(values, costs, "o-", color=COLORS[kind], lw=1.2, ms=4)
    axes.set(xscale="log", yscale="log")
    axes.set_xticks(values, [f"{value:,}" for value in values], fontsize=7)
    axes.minorticks_off()
    axes.set_ylim(min(costs) / 2, 2 * max(costs))
    axes.set_yticks(sorted({min(costs), max(costs)}))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:.3g}"))
    text = f"slope {slope(rows, kind):.2f}"
    axes.annotate(text, (0.05, 0.9), xycoords="axes fraction", fontsize=8)


def page(data: dict, out: Path) -> None:
    """`out`.svg and `out`.png."""
    names = knobs_in(data)
    with matplotlib.rc_context(STYLE):
        size = (2.6 * len(names), 4.2)
        figure, grid = pyplot.subplots(
            2, len(names), figsize=size, layout="constrained", squeeze=False
        )
        for column, name in enumerate(names):
            for line, (kind, label) in enumerate(KINDS.items()):
                axes = grid[line, column]
                draw(axes, curve(data, name), kind)
                if column == 0:
                    axes.set_ylabel(label, fontsize=8)
            grid[1, column].set_xlabel(KNOBS[name].title, fontsize=8)
        saved(figure, out, dpi=120)


def main() -> None:
    data, out = rows_and_out(__doc__)
    page(data, out / "work")


if __name__ == "__main__":
    run_stage(main)
