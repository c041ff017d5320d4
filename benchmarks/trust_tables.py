"""Tables of the rows of benchmarks.trust: how well the score tells failures, where it is wrong."""

from __future__ import annotations

import numpy as np

from benchmarks.markdown import number, pipe_table
from benchmarks.trust import LIMIT, figures, left_out


def summary(rows: list[dict]) -> str:
    """Figures of the score on kinds of scenes that its model has not seen."""
    found = figures(rows)
    low, high = found["auroc_interval"]
    body = [
        ["runs, kinds of scenes", f"{found['runs']}, {found['kinds']}"],
        [f"runs below {LIMIT:g} dB under new light", str(found["failures"])],
        ["AUROC", f"{number(found['auroc'], 3)} ({number(low, 2)} to {number(high, 2)})"],
        ["Brier score", number(found["brier"], 3)],
        ["failures with a chance of .5 or more", number(found["failures_found"], 2)],
        ["others with a chance of .5 or more", number(found["false_alarms"], 2)],
    ]
    return pipe_table(["judged by a model that has not seen the kind", ""], body)


def wrong(rows: list[dict]) -> str:
    """The runs that the score is wrong about, the worst first."""
    chance = left_out(rows)
    failed = np.array([row["relight_psnr"] < LIMIT for row in rows])
    body = []
    for k in np.argsort(-np.abs(chance - failed)):
        if (chance[k] >= 0.5) != failed[k]:
            row, given = rows[k], rows[k]["evidence"]
            cells = [f"`{row['scene']}`", number(row["relight_psnr"]), number(chance[k], 2)]
            cells += [number(given["agreement"]), number(given["explained"])]
            body.append([*cells, number(given["level"], 2), number(given["outline"], 2)])
    head = ["run", "relight dB", "chance of failure", "agreement dB", "unseen photos dB"]
    return pipe_table([*head, "spread of level", "outline"], body)
