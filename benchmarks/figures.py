"""How charts look, and how they are written: the same file for the same rows."""

from __future__ import annotations

import argparse
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

from matplotlib import pyplot
from matplotlib.figure import Figure

from pipeline.base.files import atomic_path, read_json

__all__ = ["STYLE", "matplotlib", "pyplot", "rows_and_out", "saved"]

STYLE = {
    "font.size": 9,
    "svg.hashsalt": "heliograph",  # ids that do not change from run to run
    "svg.fonttype": "none",
    "axes.spines.top": False,
    "axes.spines.right": False,
}


def saved(figure: Figure, out: Path, dpi: int) -> None:
    """`out`.svg and `out`.png, without a date; the figure is closed."""
    for end in (".svg", ".png"):
        keep = {"Date": None} if end == ".svg" else {"Software": None}
        with atomic_path(out.with_suffix(end)) as path:
            figure.savefig(path, dpi=dpi, metadata=keep)
    pyplot.close(figure)


def rows_and_out(text: str | None) -> tuple[dict, Path]:
    """What a chart's command line names, whose help is `text`: --rows, what a benchmark has
    gathered, as it wrote it or as it is committed, and the folder --out.
    """
    parser = argparse.ArgumentParser(
        description=text, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rows", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    args = parser.parse_args()
    found = read_json(args.rows)
    return found.get("data", found), args.out
