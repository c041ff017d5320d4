"""Things on a table, from photos with nothing given (benchmarks/tabletop.py)."""

from __future__ import annotations

from functools import partial

from benchmarks.markdown import number, pipe_table
from benchmarks.tables.committed import nested, rows_of, source

FILES = (
    "tabletop",
    "tabletop_earned",
    "tabletop_again",
    "tabletop_dark",
    "tabletop_unseen",
    "tabletop_by_lot",
    "tabletop_before",
)
FIGURES: list[tuple[str, tuple[str, ...], int]] = [
    ("cameras off, % of the thing's size", ("truth", "camera_error_median_percent"), 2),
    ("masks: IoU", ("silhouettes", "iou"), 3),
    ("F-score at 1 %", ("truth", "f1_at_1_percent_of_size"), 3),
    ("normals: median degrees", ("truth", "normal_error_median_degrees"), 1),
    ("held out, dB: unlit", ("unlit_psnr",), 2),
    ("lit", ("lit_psnr",), 2),
]


def table(file: str) -> str:
    """Things of a file of rows down; one that failed says so."""
    body = []
    for row in rows_of(file):
        name = row["scene"].removesuffix("_table")
        if "failed" in row:
            body.append([name, row["failed"], *[""] * (len(FIGURES) + 2)])
            continue
        cells = [number(nested(row, *keys), digits) for _, keys, digits in FIGURES]
        minutes = number(sum(row["seconds"].values()) / 60, 1)
        body.append([name, row["photos"], row["mesh"], *cells, minutes])
    head = ["thing", "photos placed", "surface", *(name for name, _, _ in FIGURES)]
    return pipe_table(head + ["sum of stage times, min"], body) + source(file)


TABLES = {file: partial(table, file) for file in FILES}
