"""Loops over observed pixels, compiled with numba: each goes through the pixels once, where array
by array millions of them would be read and written many times.

n pixels, each between four texels of a map with t * t texels, row after row: `texel` (n, 4),
uint32, says which they are and `share` (n, 4) how near they lie (`corners`). Arrays are float32
where nothing else is said. A division by zero gives infinity, as numpy does: numba's own check for
it would keep a loop from being vectorised.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numba import njit

ZERO = np.float32(0)
ONE = np.float32(1)
HALF = np.float32(0.5)
DARK = np.float32(1e-9)  # what a mean is not divided by
LEVEL = np.float32(1e-2)  # relative differences d below which log(1 + d) / d is 1 - d / 2
SUMS = {"reassoc", "contract", "nsz"}  # liberties of sums, which may be taken in any order


def compiled(**options: Any) -> Callable:
    """numba's decorator, as all loops here have it."""
    return njit(cache=True, error_model="numpy", **options)


@compiled()
def corners_into(uv: np.ndarray, side: int, texel: np.ndarray, share: np.ndarray) -> None:
    """Write the four texels around places uv (n, 2) of a map (side, side), and their bilinear
    shares. Row 0 of it is v = 1; texel centres lie at +0.5; beyond the last ones the map goes on.
    """
    end = side - 1
    for i in range(len(uv)):
        x, y = np.float32(uv[i, 0] * side) - HALF, np.float32((ONE - uv[i, 1]) * side) - HALF
        left, top = np.floor(x), np.floor(y)
        column, row = int(left), int(top)
        above, below = min(max(row, 0), end), min(max(row + 1, 0), end)
        before, after = min(max(column, 0), end), min(max(column + 1, 0), end)
        x, y = x - left, y - top
        texel[i, 0], share[i, 0] = above * side + before, (ONE - x) * (ONE - y)
        texel[i, 1], share[i, 1] = above * side + after, x * (ONE - y)
        texel[i, 2], share[i, 2] = below * side + before, (ONE - x) * y
        texel[i, 3], share[i, 3] = below * side + after, x * y


def corners(uv: np.ndarray, side: int) -> tuple[np.ndarray, np.ndarray]:
    """`texel` and `share` of places uv (n, 2) of a map (side, side)."""
    texel, share = np.empty((len(uv), 4), np.uint32), np.empty((len(uv), 4), np.float32)
    corners_into(np.ascontiguousarray(uv, np.float32), side, texel, share)
    return texel, share


@compiled()
def gather_into(image: np.ndarray, texel: np.ndarray, share: np.ndarray, out: np.ndarray) -> None:
    """Bilinear values of an image (t * t, c), written to `out` (n, c)."""
    for i in range(len(texel)):
        a, b, c, d = texel[i, 0], texel[i, 1], texel[i, 2], texel[i, 3]
        of_a, of_b, of_c, of_d = share[i, 0], share[i, 1], share[i, 2], share[i, 3]
        for k in range(image.shape[1]):
            upper = of_a * image[a, k] + of_b * image[b, k]
            out[i, k] = upper + of_c * image[c, k] + of_d * image[d, k]


@compiled()
def scatter_onto(texel: np.ndarray, share: np.ndarray, values: np.ndarray, out: np.ndarray) -> None:
    """Add values (n, c) bilinearly to the map `out` (t * t, c): the transpose of `gather_into`."""
    if values.shape[1] == 3:  # the same, in an order that is vectorised
        for i in range(len(texel)):
            for corner in range(4):
                place, part = texel[i, corner], share[i, corner]
                for k in range(3):
                    out[place, k] += part * values[i, k]
        return
    for k in range(values.shape[1]):
        for i in range(len(texel)):
            value = values[i, k]
            out[texel[i, 0], k] += share[i, 0] * value
            out[texel[i, 1], k] += share[i, 1] * value
            out[texel[i, 2], k] += share[i, 2] * value
            out[texel[i, 3], k] += share[i, 3] * value


@compiled()
def left_over_into(
    color: np.ndarray,
    scaled: np.ndarray,
    rest: np.ndarray,
    photo: np.ndarray,
    weight: np.ndarray,
) -> None:
    """Overwrite colours (m,) with weight (photo - (color scaled + rest)); all are (m,)."""
    for i in range(len(color)):
        color[i] = weight[i] * (photo[i] - (color[i] * scaled[i] + rest[i]))


@compiled(fastmath=SUMS)
def secants_into(
    picture: np.ndarray,
    photo: np.ndarray,
    log_picture: np.ndarray,
    log_photo: np.ndarray,
    weight: np.ndarray,
    floor: np.float32,
) -> float:
    """Write to `weight`, for values of a picture and a photo and the logs of either above `floor`,
    what their difference counts as that of the logs, (log(photo + floor) - log(picture + floor)) /
    (photo - picture) / (picture + floor), values below 0 taken as 0. Returns the sum of squared
    relative errors. All are (m,).
    """
    total = 0.0
    for i in range(len(picture)):
        relative = (photo[i] - picture[i]) / (photo[i] + floor)
        total += relative * relative
        floored = max(picture[i], ZERO) + floor
        more = (max(photo[i], ZERO) + floor - floored) / floored
        near = abs(more) < LEVEL
        slope = (log_photo[i] - log_picture[i]) / (ONE if near else more)
        weight[i] = (ONE - HALF * more if near else slope) / (floored * floored)
    return total


@compiled(fastmath=SUMS)
def doubt_into(
    log_picture: np.ndarray,
    log_photo: np.ndarray,
    known: np.ndarray,
    contradiction: np.float32,
    weight: np.ndarray,
) -> None:
    """Multiply weights (n, 3) by known (n,) and Cauchy's 1 / (1 + d^2), d the mean over channels of
    the logs' difference over `contradiction`; infinity: times 1.
    """
    for i in range(len(known)):
        off = ZERO
        for k in range(3):
            off += abs(log_photo[i, k] - log_picture[i, k])
        off /= 3 * contradiction
        trust = known[i] / (ONE + off * off)
        for k in range(3):
            weight[i, k] *= trust


@compiled()
def blend_into(
    color: np.ndarray,
    shading: np.ndarray,
    of_color: np.ndarray,
    of_shading: np.ndarray,
    pixels: np.ndarray,
    around: np.float32,
) -> None:
    """Overwrite a map's colours (t, t, 3), known from around each texel, with what its own sums
    (`TexelSums`) say besides, and the shading of one pixel with the mean over those and one more.
    """
    for row in range(len(color)):
        for column in range(color.shape[1]):
            count = pixels[row, column, 0] + ONE
            for k in range(3):
                weight = around * shading[row, column, k]
                lit = of_shading[row, column, k]
                both = of_color[row, column, k] + weight * color[row, column, k]
                color[row, column, k] = both / max(lit + weight, DARK)
                shading[row, column, k] = (lit + shading[row, column, k]) / count


@compiled()
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


@compiled()
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
