"""Loops over observed pixels, compiled with numba: each goes through the pixels once, where array
by array millions of them would be read and written many times.

n pixels, at texture coordinates uv (n, 2) of maps (t, t, c), row 0 of which is v = 1; texel centres
lie at +0.5. Arrays are float32 where nothing else is said.
"""

from __future__ import annotations

import numpy as np
from numba import njit

ZERO = np.float32(0)
ONE = np.float32(1)
HALF = np.float32(0.5)
LEVEL = np.float32(1e-3)  # relative differences below which log(1 + d) / d is 1


@njit(cache=True)
def four_texels(u: float, v: float, side: int) -> tuple[int, int, int, int, float, float]:
    """The rows and columns between which a place of a map lies, and how far between them."""
    x, y = np.float32(u * side) - HALF, np.float32((ONE - v) * side) - HALF
    left, top = np.floor(x), np.floor(y)
    column, row, end = int(left), int(top), side - 1
    above, below = min(max(row, 0), end), min(max(row + 1, 0), end)
    before, after = min(max(column, 0), end), min(max(column + 1, 0), end)
    return above, below, before, after, x - left, y - top


@njit(cache=True)
def gather_into(image: np.ndarray, uv: np.ndarray, out: np.ndarray) -> None:
    """Bilinear values of an image, written to `out` (n, c)."""
    for i in range(len(uv)):
        above, below, before, after, x, y = four_texels(uv[i, 0], uv[i, 1], len(image))
        for c in range(image.shape[2]):
            up = (ONE - x) * image[above, before, c] + x * image[above, after, c]
            down = (ONE - x) * image[below, before, c] + x * image[below, after, c]
            out[i, c] = (ONE - y) * up + y * down


@njit(cache=True)
def scatter_onto(uv: np.ndarray, values: np.ndarray, out: np.ndarray) -> None:
    """Add values (n, c) bilinearly to the map `out`: the transpose of `gather_into`."""
    for i in range(len(uv)):
        above, below, before, after, x, y = four_texels(uv[i, 0], uv[i, 1], len(out))
        for c in range(values.shape[1]):
            up, down = (ONE - y) * values[i, c], y * values[i, c]
            out[above, before, c] += (ONE - x) * up
            out[above, after, c] += x * up
            out[below, before, c] += (ONE - x) * down
            out[below, after, c] += x * down


@njit(cache=True)
def left_over_onto(
    uv: np.ndarray,
    color: np.ndarray,
    scaled: np.ndarray,
    rest: np.ndarray,
    photo: np.ndarray,
    weight: np.ndarray,
    out: np.ndarray,
) -> None:
    """Add weight (photo - (color scaled + rest)) of every pixel to the map `out`; color: a map, the
    others (n, 3).
    """
    for i in range(len(uv)):
        above, below, before, after, x, y = four_texels(uv[i, 0], uv[i, 1], len(out))
        for c in range(3):
            up = (ONE - x) * color[above, before, c] + x * color[above, after, c]
            down = (ONE - x) * color[below, before, c] + x * color[below, after, c]
            picture = ((ONE - y) * up + y * down) * scaled[i, c] + rest[i, c]
            left = weight[i, c] * (photo[i, c] - picture)
            up, down = (ONE - y) * left, y * left
            out[above, before, c] += (ONE - x) * up
            out[above, after, c] += x * up
            out[below, before, c] += (ONE - x) * down
            out[below, after, c] += x * down


@njit(cache=True)
def secant(picture: np.float32, photo: np.float32, floor: np.float32) -> np.float32:
    """(log(photo + floor) - log(picture + floor)) / (photo - picture) / (picture + floor) of values
    that are not below 0.
    """
    floored = picture + floor
    more = (photo - picture) / floored
    slope = ONE if abs(more) < LEVEL else np.log1p(more) / more
    return slope / (floored * floored)


@njit(cache=True)
def weigh_into(
    picture: np.ndarray,
    photo: np.ndarray,
    known: np.ndarray,
    contradiction: float,
    floor: float,
    weight: np.ndarray,
) -> float:
    """Write to `weight` (n, 3) what a photo's difference from a picture, both (n, 3), counts: that
    of the log (`secant`), times known (n,), times Cauchy's 1 / (1 + d^2), d the mean over the
    channels of |log| over `contradiction`; infinity: times 1. Returns the mean squared relative
    error.
    """
    total, shade, tolerated = 0.0, np.float32(floor), np.float32(3 * contradiction)
    for i in range(len(known)):
        off = ZERO
        for c in range(3):
            relative = (photo[i, c] - picture[i, c]) / (photo[i, c] + shade)
            total += relative * relative
            if tolerated < np.inf:
                floored = max(picture[i, c], ZERO) + shade
                off += abs(np.log(floored / (photo[i, c] + shade)))
        off /= tolerated
        trust = known[i] / (ONE + off * off)
        for c in range(3):
            seen, shown = max(photo[i, c], ZERO), max(picture[i, c], ZERO)
            weight[i, c] = trust * secant(shown, seen, shade)
    return total / max(photo.size, 1)


@njit(cache=True)
def add_moments(number: np.ndarray, guide: np.ndarray, values: np.ndarray, out: np.ndarray) -> None:
    """Add to `out` (cells, 1 + g, 1 + g + c), float64, the products of (1, guide) with (1, guide,
    values) of every pixel, each in the cell `number` (n,); guide (n, g), values (n, c).
    """
    g, c = guide.shape[1], values.shape[1]
    right = np.ones(1 + g + c)
    for i in range(len(number)):
        right[1 : 1 + g] = guide[i]
        right[1 + g :] = values[i]
        sums = out[number[i]]
        for j in range(1 + g):
            for k in range(1 + g + c):
                sums[j, k] += right[j] * right[k]


@njit(cache=True)
def predict_into(
    coefficients: np.ndarray,
    weight: np.ndarray,
    at: np.ndarray,
    guide: np.ndarray,
    out: np.ndarray,
) -> None:
    """Write to `out` (n, c) the constants and slopes (rows, columns, 1 + g, c) of cells, in the
    mean over the four around each place `at` (n, 2; column, row) by nearness and by the cells'
    `weight` (rows, columns), at the guides (n, g).
    """
    rows, columns, terms, channels = coefficients.shape
    for i in range(len(at)):
        left, top = np.floor(at[i, 0]), np.floor(at[i, 1])
        x, y = at[i, 0] - left, at[i, 1] - top
        out[i] = 0
        total = 0.0
        for corner in range(4):
            right, down = corner & 1, corner >> 1
            column = min(max(int(left) + right, 0), columns - 1)
            row = min(max(int(top) + down, 0), rows - 1)
            near = (x if right else 1 - x) * (y if down else 1 - y) * weight[row, column]
            total += near
            of_cell = coefficients[row, column]
            for c in range(channels):
                value = of_cell[0, c]
                for k in range(terms - 1):
                    value += guide[i, k] * of_cell[1 + k, c]
                out[i, c] += near * value
        out[i] /= max(total, 1e-12)
