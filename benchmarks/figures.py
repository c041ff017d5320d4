"""How charts look, and how they are written: the same file for the same rows."""

from __future__ import annotations

from pathlib import Path

import matplotlib

matplotlib.use("Agg")

from matplotlib import pyplot
from matplotlib.figure import Figure

from pipeline.base.files import atomic_path

__all__ = ["STYLE", "matplotlib", "pyplot", "saved"]

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
