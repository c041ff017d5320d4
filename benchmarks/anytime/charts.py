"""Anytime curves as a chart, as SVG and PNG.

python -m benchmarks.anytime.charts --rows benchmarks/results/anytime.json --out docs
"""

from __future__ import annotations

from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from benchmarks.anytime.tables import methods_in, points, scenes_in
from benchmarks.figures import STYLE, matplotlib, pyplot, rows_and_out, saved
from benchmarks.study.charts import COLORS
from benchmarks.study.methods import is_ours
from pipeline.base.errors import run_stage

PANELS = {
    "relight_psnr": "relight PSNR, dB",
    "novel_view_psnr": "new views, dB",
    "light_psnr_log": "light, log, dB",
}
DASHES = ("-", "--", ":", "-.")  # of a family's methods, in order


def styles(methods: list[str]) -> dict[str, dict]:
    """Ours in one colour, others in another, told apart by their dashes."""
    found = {}
    for family in ("ours", "others"):
        mine = [name for name in methods if is_ours(name) == (family == "ours")]
        for k, name in enumerate(mine):
            found[name] = {"color": COLORS[family], "ls": DASHES[k % len(DASHES)]}
    return found


def draw(axes: Axes, rows: list[dict], kind: str) -> None:
    """A panel: a line for every method, with a dot where the run ends by itself."""
    methods = methods_in(rows)
    for name, style in styles(methods).items():
        curve = points(rows, name)
        seconds, values = [p.seconds for p in curve], [p.scores[kind] for p in curve]
        axes.plot(seconds, values, lw=1.4, marker=".", ms=4, label=name, **style)
        axes.plot(seconds[-1], values[-1], "o", ms=6, color=style["color"])
    axes.set_xscale("log")
    axes.xaxis.set_major_locator(LogLocator(subs=(1, 3)))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.set_xlabel("seconds on two cores, refinement included", fontsize=8)
    axes.set_title(PANELS[kind], fontsize=9, loc="left")


def page(rows: list[dict], out: Path) -> None:
    """`out`.svg and `out`.png."""
    with matplotlib.rc_context(STYLE):
        size = (3.4 * len(PANELS), 3.4)
        figure, grid = pyplot.subplots(1, len(PANELS), figsize=size, layout="constrained")
        for axes, kind in zip(grid, PANELS):
            draw(axes, rows, kind)
        grid[0].legend(fontsize=7, frameon=False, loc="center right")
        figure.suptitle(
            f"runs stopped early, mean of {len(scenes_in(rows))} scenes; large dots: the whole run",
            fontsize=9,
            x=0.01,
            ha="left",
        )
        saved(figure, out, dpi=120)


def main() -> None:
    data, out = rows_and_out(__doc__)
    page(data["rows"], out / "anytime")


if __name__ == "__main__":
    run_stage(main)
