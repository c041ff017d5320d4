"""How well several draws of a posterior say what is known, and how unsure they are."""

from __future__ import annotations

import numpy as np
from scipy.special import ndtri, stdtrit

NOMINAL = (0.5, 0.8, 0.95)
# root mean square error, sRGB, that all draws of a scene share: base colours and relit pixels of
# development scenes ask for it (docs/calibration.md)
COMMON_ERROR = 0.03


def predictive_reach(count: int, nominal: float) -> float:
    """Half-width of Student's predictive interval about the mean of `count` draws that is to hold a
    share of `nominal`, over their standard deviation (n - 1).
    """
    return float(stdtrit(count - 1, 0.5 + 0.5 * nominal) * np.sqrt(1 + 1 / count))


def half_width(deviation: np.ndarray, count: int, nominal: float, common: float) -> np.ndarray:
    """Half-width of the interval about the mean of `count` draws that is to hold a share of
    `nominal`, for their standard deviation (n - 1), where they also miss the truth together by a
    normal error of deviation `common`: the half-widths of Student's predictive interval and of the
    normal one, added as independent errors are.
    """
    apart = predictive_reach(count, nominal) * deviation
    return np.hypot(apart, ndtri(0.5 + 0.5 * nominal) * common)


def held_within(
    draws: np.ndarray, truth: np.ndarray, common: float, about: np.ndarray | None = None
) -> dict[str, float]:
    """As `coverage`, of intervals of `half_width` about the draws' mean, or about values (k,) that
    are given: a picture of the draws' mean is not the mean of their pictures.
    """
    off = np.abs(truth - (draws.mean(0) if about is None else about))
    deviation = draws.std(0, ddof=1)
    return {
        f"{nominal:.0%}": float((off <= half_width(deviation, len(draws), nominal, common)).mean())
        for nominal in NOMINAL
    }


def coverage(draws: np.ndarray, truth: np.ndarray) -> dict[str, float]:
    """Share of the unknowns whose true value (k,) the central interval of draws (n, k) holds, per
    nominal share.

    A new draw falls between order statistics i and j of n others with probability (j - i) / (n +
    1), so 9 draws have an 80 % interval between least and greatest; wider ones are Student's
    predictive intervals.
    """
    n = len(draws)
    out = {}
    for nominal in NOMINAL:
        rank = 0.5 * (1 - nominal) * (n + 1)
        if rank >= 1:
            low, high = np.quantile(draws, [(rank - 1) / (n - 1), 1 - (rank - 1) / (n - 1)], axis=0)
        else:
            reach = predictive_reach(n, nominal) * draws.std(0, ddof=1)
            low = draws.mean(0) - reach
            high = draws.mean(0) + reach
        out[f"{nominal:.0%}"] = float(((truth >= low) & (truth <= high)).mean())
    return out


def crps(draws: np.ndarray, truth: np.ndarray) -> float:
    """Continuous ranked probability score of draws (n, k) for true values (k,), mean over them, in
    their units: E|X - y| - E|X - X'| / 2, with the unbiased estimate of the second term over pairs
    (Gneiting and Raftery 2007, eq. 21; Ferro 2014). Of one draw it is the absolute error.
    """
    n = len(draws)
    error = np.abs(draws - truth).mean()
    if n == 1:
        return float(error)

    rank = 2 * np.arange(1, n + 1) - n - 1
    pairs = (rank[:, None] * np.sort(draws, axis=0)).sum(0) * 2  # sum over i, j of |x_i - x_j|
    return float(error - 0.5 * pairs.mean() / (n * (n - 1)))


def sample_variance(draws: np.ndarray) -> float:
    """Unbiased variance between draws (n, k), mean over the unknowns. ValueError for one draw."""
    if len(draws) < 2:
        raise ValueError("one draw has no variance")
    return float(draws.var(0, ddof=1).mean())
