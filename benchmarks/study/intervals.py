"""Paired differences between two methods with bootstrap intervals."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy import stats

RESAMPLES = 4000
LEVEL = 0.95


def paired(a: np.ndarray, b: np.ndarray) -> tuple[float, float, float]:
    """Mean of a - b over units (n,), and its bootstrap interval: percentiles of means of n units
    drawn with replacement, both methods' values of a unit together (Efron and Tibshirani 1993,
    ch. 13). Without an interval (nan) for fewer than 2 units.
    """
    difference = np.asarray(a, float) - np.asarray(b, float)
    if len(difference) < 2:
        return float(difference.mean()), np.nan, np.nan
    found = resampled(len(difference), lambda chosen: difference[chosen].mean(-1))
    return float(difference.mean()), *found


def resampled(units: int, statistic: Callable[[np.ndarray], np.ndarray]) -> tuple[float, float]:
    """Bootstrap interval of a statistic of `units` units, a function (..., n) -> (...) of their
    numbers: percentiles of its values for units drawn with replacement.
    """
    found = stats.bootstrap(
        (np.arange(units),),
        lambda chosen, axis: statistic(np.moveaxis(chosen, axis, -1)),
        n_resamples=RESAMPLES,
        confidence_level=LEVEL,
        method="percentile",
        rng=np.random.default_rng(0),
    ).confidence_interval
    return float(found.low), float(found.high)


def views_of(rows: list[dict], kind: str) -> np.ndarray:
    """Scores (pictures,) of a method on one scene, mean over its seeds, of the pictures whose name
    begins with `kind`.
    """
    names = sorted(name for name in rows[0]["views"] if name.startswith(kind))
    return np.array([np.mean([row["views"][name] for row in rows]) for name in names])
