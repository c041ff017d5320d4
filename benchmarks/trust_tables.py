"""Tables of the rows of benchmarks.trust: how well the score tells failures, and
examples of what it says."""

from __future__ import annotations

import numpy as np

from benchmarks.markdown import number, pipe_table
from benchmarks.trust import ALARM, LIMIT, figures, left_out

RIGHT = 3  # right alarms that are shown


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


def verdicts(chance: np.ndarray, failed: np.ndarray) -> dict[str, np.ndarray]:
    """Numbers of the runs that are alarms, right and false, and of failures that were missed, each
    with the clearest first.
    """
    alarm = chance >= ALARM
    order = np.argsort(-np.abs(chance - ALARM))
    kinds = {"right alarm": alarm & failed, "false alarm": alarm & ~failed}
    kinds["missed"] = ~alarm & failed
    return {name: order[chosen[order]] for name, chosen in kinds.items()}


def examples(rows: list[dict]) -> str:
    """Runs with an alarm, the clearest RIGHT of the right ones and all false ones, and all failures
    without one.
    """
    chance = left_out(rows)
    failed = np.array([row["relight_psnr"] < LIMIT for row in rows])
    body = []
    for name, found in verdicts(chance, failed).items():
        for k in found[: RIGHT if name == "right alarm" else None]:
            row, given = rows[k], rows[k]["evidence"]
            cells = [name, f"`{row['scene']}`", number(row["relight_psnr"]), number(chance[k], 2)]
            cells += [number(given["agreement"]), number(given["explained"])]
            body.append([*cells, number(given["level"], 2), number(given["outline"], 2)])
    head = ["", "run", "relight dB", "chance of failure", "agreement dB", "unseen photos dB"]
    return pipe_table([*head, "spread of level", "outline"], body)
