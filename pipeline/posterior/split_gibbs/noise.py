"""The rows' errors: drawn given the points' colours, and how much neighbours err together."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from pipeline.posterior.split_gibbs.row_model import RowModel
from pipeline.posterior.split_gibbs.state import Noise
from pipeline.render.rows import Rows

# degrees of freedom of the errors' Student's t
NU = 4.0
# a correlation below this counts as none
UNCORRELATED = 0.05


def log_noise(model: RowModel, U: np.ndarray, W: np.ndarray, colors: np.ndarray) -> float:
    """Log-density of all residuals given the points' colours (p, 3), up to a constant.

    lambda is integrated out: Student's t of scale eta; saturated values are a penalty only.
    """
    relative, explained = model.misfit(U, W, colors)
    scale = model.noise.scale
    count = (~explained).sum(1)
    tail = 0.5 * (NU + count) * np.log1p(relative.sum(1) / (NU * scale**2))
    return float(-tail.sum() - model.data.unbounded.sum() * np.log(scale))


def draw_noise(
    model: RowModel,
    U: np.ndarray,
    W: np.ndarray,
    colors: np.ndarray,
    rng: np.random.Generator,
) -> Noise:
    """lambda given eta, then eta given lambda, both given the points' colours (p, 3).

    Saturated values have no say in eta. A draw of eta^2 is inverse gamma.
    """
    relative, explained = model.misfit(U, W, colors)
    shape = 0.5 * (NU + (~explained).sum(1))
    rate = 0.5 * (NU + relative.sum(1) / model.noise.scale**2)
    weight = rng.gamma(shape, 1 / rate)

    rest = model.data.unbounded
    effect = model.noise.design_effect
    freedom = relative[rest].size / effect
    square = (weight[:, None] * relative)[rest].sum() / effect
    scale = float(np.sqrt((0.5 * square + 1e-4) / rng.gamma(0.5 * freedom + 1.0)))
    return replace(model.noise, scale=scale, weight=weight)


def channel_effect(residual: np.ndarray) -> float:
    """Channels per independent channel, residual (n, 3): a wrong normal or shadow errs in all three
    at once.
    """
    r = residual / np.maximum(residual.std(0), 1e-12)
    r = np.clip(r - r.mean(0), -4, 4)
    return 1 + 2 * float(np.clip((np.corrcoef(r.T).sum() - 3) / 6, 0, 1))


def neighbour_effect(
    rows: Rows, position: np.ndarray, view: np.ndarray, residual: np.ndarray, bins: int = 12
) -> float:
    """Rows per independent row (the design effect of Kish 1965): 1 + the sum over other rows of the
    same view of the residuals' correlation at that distance.

    residual (n,) standardised; position (n, 3); view (n,). Correlations are averaged in distance
    bins, the first one reaching 1.5 times the usual distance of neighbours, and taken as zero from
    the first bin below UNCORRELATED on.
    """
    first = position[rows.starts]
    reach = 1.5 * bins * float(np.median(cKDTree(first).query(first, 2)[0][:, 1]))
    top = np.zeros(bins)
    count = np.zeros(bins)
    r = (residual - residual.mean()) / max(residual.std(), 1e-12)
    for k in np.unique(view):
        mine = np.flatnonzero(view == k)
        pairs = cKDTree(position[mine]).query_pairs(reach, output_type="ndarray")
        if len(pairs):
            i, j = mine[pairs.T]
            distance = np.linalg.norm(position[i] - position[j], axis=1)
            which = np.minimum((distance / reach * bins).astype(int), bins - 1)
            top += np.bincount(which, r[i] * r[j], bins)
            count += np.bincount(which, minlength=bins)

    correlation = np.where(count > 20, top / np.maximum(count, 1), 0)
    low = correlation < UNCORRELATED
    end = np.argmax(low) if low.any() else bins
    return float(1 + 2 * (correlation[:end] * count[:end]).sum() / len(residual))
