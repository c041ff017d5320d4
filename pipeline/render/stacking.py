"""How much every sample counts in their mean: stacking, by photos that none was fitted to.

A chain ends in the explanation that its start led to. So explanations are drawn as often as starts
lead there, which is not as often as they are probable: chains do not mix. Their mean takes the
weights w of that mixture of them which predicts best what was left out (stacking: Wolpert 1992,
Breiman 1996; of chains that do not mix: Yao, Vehtari and Gelman 2022):

    w = argmin w' (M + e I) w  over w >= 0, sum w = 1,    M_ij = mean of r_i s_j

with r_i, s_i what two independent pictures of sample i have more than the photos, as sRGB values,
under base colours from other photos (posterior/left_out.py): a square would hold the paths' noise.
A sample that errs where others are right, or the other way than they do, counts more than one that
repeats them. The mean is for other lights, under which every sample errs by e more in a way of its
own that these photos do not show: what they tell apart by a few per cent counts nearly alike.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.optimize import minimize

from pipeline.base.errors import InputError

FILE = "left_out.npz"
STEPS = 500
TOLERANCE = 1e-10  # of what is minimised, over the mean of the samples' errors
UNSEEN = 1.0  # e, over that mean


@dataclass(frozen=True)
class LeftOut:
    """Of one sample: number of every observed pixel that judges (n,), and what two pictures have
    more than the photos there, sRGB (2, n, 3).
    """

    pixel: np.ndarray
    residual: np.ndarray

    @classmethod
    def by_none(cls) -> LeftOut:
        """Where photos are too few to leave any out: n = 0."""
        return cls(np.zeros(0, int), np.zeros((2, 0, 3), np.float32))

    def save(self, folder: Path) -> None:
        """Into the sample's folder, residuals in single precision."""
        np.savez(folder / FILE, pixel=self.pixel, residual=self.residual.astype(np.float32))

    @classmethod
    def load(cls, folder: Path) -> LeftOut:
        """What `save` wrote. Raises InputError where there is none."""
        if not (folder / FILE).exists():
            cure = "it was refined by an earlier version: refine it anew"
            raise InputError("the sample has not been judged by photos left out", folder, cure)
        with np.load(folder / FILE) as found:
            return cls(found["pixel"], found["residual"])


def weights(judged: Sequence[LeftOut]) -> np.ndarray:
    """w (N,) of N samples; even ones where no photo judges. Raises InputError where other pixels
    judge one sample than another.
    """
    count, first = len(judged), judged[0].pixel
    even = np.full(count, 1 / count)
    if any(not np.array_equal(other.pixel, first) for other in judged):
        cure = "refine all samples of the scene anew"
        raise InputError("its samples were judged by different pixels", "refine", cure)
    if count == 1 or not len(first):
        return even

    one, two = (np.stack([x.residual[k].ravel() for x in judged]).astype(float) for k in range(2))
    M = one @ two.T / one.shape[1]
    M = 0.5 * (M + M.T)
    M = M / max(float(np.abs(np.diag(M)).mean()), 1e-12) + UNSEEN * np.eye(count)
    found = minimize(
        lambda w: w @ M @ w,
        even,
        jac=lambda w: 2 * M @ w,
        bounds=[(0, 1)] * count,
        constraints={"type": "eq", "fun": lambda w: w.sum() - 1, "jac": np.ones_like},
        method="SLSQP",
        options={"ftol": TOLERANCE, "maxiter": STEPS},
    )
    w = np.clip(found.x, 0, None)
    return w / w.sum()
