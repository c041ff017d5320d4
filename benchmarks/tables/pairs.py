"""Samplers against each other on the pairs of an object and a light, and on garden."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from benchmarks.markdown import number, pipe_table
from benchmarks.tables.committed import by_scene, nested, results, rows_of, source, title

NOMINAL = ("50%", "80%", "95%")
# Columns of the pairs: heading, keys in a row, digits, and how far a value is from the best one.
COLUMNS: list[tuple[str, tuple[str, ...], int, Callable[[float], float]]] = [
    ("light dB, a draw", ("light_psnr",), 1, lambda v: -v),
    ("light dB, mean of draws", ("light_psnr_of_mean",), 1, lambda v: -v),
    ("held-out dB", ("held_out_psnr",), 1, lambda v: -v),
    ("relit dB", ("relit_psnr",), 1, lambda v: -v),
    ("base colour RMS, raw", ("base_colour_rms",), 3, lambda v: v),
    ("base colour RMS, aligned", ("base_colour_rms_aligned",), 3, lambda v: v),
    ("80 % hold: SH", ("coverage", "sh", "80%"), 2, lambda v: abs(v - 0.8)),
    ("SH over its mean", ("coverage", "sh_relative", "80%"), 2, lambda v: abs(v - 0.8)),
    ("base colour of regions", ("coverage", "base_colour", "80%"), 2, lambda v: abs(v - 0.8)),
    ("relit pixels", ("coverage", "relit", "80%"), 2, lambda v: abs(v - 0.8)),
]
ERRORS = COLUMNS[:6]


def rounded(value: float | None, digits: int) -> float | None:
    return None if value is None else round(value, digits)


def mean_of(name: str, *keys: str) -> float:
    """Mean of a figure over the rows. Rows transcribed from an older page have rounded figures, and
    not all of them: their `means`, as that page had them, go before.
    """
    printed = nested(results(name)["data"], "means", *keys)
    return float(np.mean([nested(r, *keys) for r in rows_of(name)])) if printed is None else printed


def pairs() -> str:
    """Both methods on every pair; dpi_paper's figure in bold where it is the better one."""
    ours, theirs = by_scene("pairs_split_gibbs"), by_scene("pairs_dpi_paper")
    body = []
    for scene, row in ours.items():
        cells = [title(scene)]
        for _, keys, digits, distance in COLUMNS:
            a, b = (rounded(nested(r, *keys), digits) for r in (row, theirs[scene]))
            other = number(b, digits)
            better = a is not None and b is not None and distance(b) < distance(a)
            cells.append(f"{number(a, digits)} ({f'**{other}**' if better else other})")
        body.append(cells)
    mean = ["mean of the pairs"]
    for _, keys, digits, _ in COLUMNS:
        a, b = (mean_of(name, *keys) for name in ("pairs_split_gibbs", "pairs_dpi_paper"))
        mean.append(f"{number(a, digits)} ({number(b, digits)})")
    head = ["scene", *(heading for heading, *_ in COLUMNS)]
    both = source("pairs_split_gibbs") + source("pairs_dpi_paper")
    return pipe_table(head, [*body, mean]) + both


def intervals() -> str:
    """Share held by the 50, 80 and 95 % intervals, mean over the pairs."""
    names = {
        "sh": "SH coefficients of the light",
        "sh_relative": "the same over their mean",
        "base_colour": "base colour of regions",
        "relit": "relit pixels",
    }
    body = [
        [text]
        + [
            number(mean_of(f"pairs_{method}", "coverage", quantity, nominal), 2)
            for method in ("split_gibbs", "dpi_paper")
            for nominal in NOMINAL
        ]
        for quantity, text in names.items()
    ]
    head = [f"`{m}` {n[:-1]} %" for m in ("split_gibbs", "dpi_paper") for n in NOMINAL]
    return pipe_table(["share of true values inside", *head], body)


def not_better() -> str:
    """Every figure of the pairs and of garden in which dpi_paper is better than split_gibbs, or
    equal.
    """
    ours, theirs = by_scene("pairs_split_gibbs"), by_scene("pairs_dpi_paper")
    cases = [(title(s), ours[s], theirs[s]) for s in ours]
    garden = {row["method"]: row for row in rows_of("garden_draws")}
    cases.append(("garden", garden["split_gibbs"], garden["dpi_paper"]))
    body = []
    for scene, row, other in cases:
        for heading, keys, digits, distance in ERRORS:
            a, b = (rounded(nested(r, *keys), digits) for r in (row, other))
            if a is not None and b is not None and distance(b) <= distance(a):
                body.append([scene, heading, number(a, digits), number(b, digits)])
    return pipe_table(["scene", "figure", "`split_gibbs`", "`dpi_paper`"], body)


def pairs_seconds() -> str:
    """Seconds of one draw on each pair."""
    rows = rows_of("pairs_split_gibbs")
    head = [row["scene"].split("__")[0] for row in rows]
    return pipe_table(head, [[number(row["seconds"]) for row in rows]])


def pairs_all_levels() -> str:
    """dpi_paper with every noise level."""
    body = [
        [title(row["scene"])]
        + [number(nested(row, *keys), digits) for _, keys, digits, _ in COLUMNS]
        for row in rows_of("pairs_all_levels")
    ]
    return pipe_table(["scene", *(heading for heading, *_ in COLUMNS)], body) + source(
        "pairs_all_levels"
    )


def side_by_side() -> str:
    """split_gibbs against each other method on the same scene, seconds and quality."""
    rows = rows_of("side_by_side")
    ours = {row["scene"]: row for row in rows if row["method"] == "split_gibbs"}
    body = []
    for row in rows:
        if row["method"] == "split_gibbs":
            continue
        mine = ours[row["scene"]]
        method = row["method"] + (f" ({row['note']})" if "note" in row else "")
        cells = [title(row["scene"]), method, number(mine["seconds"]), number(row["seconds"], 0)]
        cells.append(number(row["seconds"] / mine["seconds"]))
        for _, (key,), digits, _ in (c for c in ERRORS if c[1] != ("light_psnr_of_mean",)):
            pair = [number(r.get(key), digits) for r in (mine, row)]
            cells.append(" \\| ".join(pair) if all(pair) else "")
        body.append(cells)
    head = "scene,other method,split_gibbs s,other s,times,light dB,held-out dB,relit dB"
    head += ",base colour raw,aligned"
    return pipe_table(head.split(","), body) + source("side_by_side")


TABLES = {
    make.__name__: make
    for make in (pairs, intervals, not_better, pairs_seconds, pairs_all_levels, side_by_side)
}
