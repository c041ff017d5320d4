"""Loops over rows, compiled with numba: each reads its matrices once, where array by array they
would be read and written many times, and a draw's time is memory's.

n rows lie point by point: those of point p are starts[p] to starts[p + 1] - 1, `starts` (p + 1,).
"""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True)
def mix_into(
    low: np.ndarray,
    high: np.ndarray,
    way: np.ndarray,
    metallic: np.ndarray,
    index: np.ndarray,
    U: np.ndarray,
    W: np.ndarray,
) -> None:
    """`lobes.mix` of the rows `index` (k,), written to U and W (n, M): lobes lie `way` (k,) between
    `low` and `high` (4, n, M), metallic (k,); all float32.
    """
    one = np.float32(1)
    for k in range(len(index)):
        i, w, m = index[k], way[k], metallic[k]
        v, d = one - w, one - m
        for j in range(U.shape[1]):
            diffuse = v * low[0, i, j] + w * high[0, i, j]
            highlight = v * low[1, i, j] + w * high[1, i, j]
            U[i, j] = d * diffuse
            W[i, j] = d * highlight
        if m > 0:
            for j in range(U.shape[1]):
                white = v * low[2, i, j] + w * high[2, i, j]
                black = v * low[3, i, j] + w * high[3, i, j]
                U[i, j] += m * (white - black)
                W[i, j] += m * black


@njit(cache=True)
def whitened_into(
    U: np.ndarray,
    W: np.ndarray,
    color: np.ndarray,
    scale: np.ndarray,
    unit: np.ndarray,
    shrink: np.ndarray,
    starts: np.ndarray,
    out: np.ndarray,
) -> None:
    """(I - shrink u u') diag(scale) (color U + W) point by point, written to `out` (n, M); U, W
    (n, M), color, scale and u = unit (n,), shrink (p,), all float32.
    """
    along = np.empty(U.shape[1], np.float32)
    for p in range(len(shrink)):
        along[:] = 0
        for i in range(starts[p], starts[p + 1]):
            a, b, u = scale[i] * color[i], scale[i], unit[i]
            for j in range(U.shape[1]):
                value = a * U[i, j] + b * W[i, j]
                out[i, j] = value
                along[j] += u * value
        for i in range(starts[p], starts[p + 1]):
            back = unit[i] * shrink[p]
            for j in range(U.shape[1]):
                out[i, j] -= back * along[j]


@njit(cache=True)
def seen_rows(
    seen: np.ndarray, roughness: np.ndarray, metallic: np.ndarray, starts: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """U and W (n, 3), as `lobes.mix`, of rows whose points show the lobe of a step `roughness` (p,)
    at `metallic` (p,); seen (steps, 4, n, 3): what every lobe sees.
    """
    n = seen.shape[2]
    U, W = np.empty((n, 3)), np.empty((n, 3))
    for p in range(len(roughness)):
        of_step, m = seen[roughness[p]], metallic[p]
        for i in range(starts[p], starts[p + 1]):
            for c in range(3):
                metal = m * (of_step[2, i, c] - of_step[3, i, c])
                U[i, c] = (1 - m) * of_step[0, i, c] + metal
                W[i, c] = (1 - m) * of_step[1, i, c] + m * of_step[3, i, c]
    return U, W


@njit(cache=True)
def sums_by_point(
    U: np.ndarray,
    W: np.ndarray,
    observed: np.ndarray,
    clipped: np.ndarray,
    precision: np.ndarray,
    color: np.ndarray,
    variance: np.ndarray,
    weight: np.ndarray,
    starts: np.ndarray,
) -> np.ndarray:
    """For every point and channel (4, p, 3): q, g, s and all_q, sums over its rows of w U^2, w U r,
    w r^2, and w U^2 with saturated rows counted in any case; r = observed - color U - W, w the
    precision (n, 3) times the point's `weight` (p,). color, variance (p, 3): of its base colours. A
    saturated row (`clipped` (n, 3)) counts where it is darker than observed, with the colour
    that the point's other rows give it.
    """
    out = np.zeros((4, len(weight), 3))
    for p in range(len(weight)):
        first, last = starts[p], starts[p + 1]
        for c in range(3):
            mu, q, g, s, saturated = color[p, c], 0.0, 0.0, 0.0, False
            for i in range(first, last):
                if clipped[i, c]:
                    saturated = True
                    continue
                u, r = U[i, c], observed[i, c] - mu * U[i, c] - W[i, c]
                w = precision[i, c] * weight[p]
                q += w * u * u
                g += w * u * r
                s += w * r * r
            all_q = q
            if saturated:
                v = max(variance[p, c], 1e-10)
                likely = mu + v * g / (1 + v * q)
                for i in range(first, last):
                    if not clipped[i, c]:
                        continue
                    u, r = U[i, c], observed[i, c] - mu * U[i, c] - W[i, c]
                    w = precision[i, c] * weight[p]
                    all_q += w * u * u
                    if likely * u + W[i, c] < observed[i, c]:
                        q += w * u * u
                        g += w * u * r
                        s += w * r * r
            out[0, p, c], out[1, p, c], out[2, p, c], out[3, p, c] = q, g, s, all_q
    return out
