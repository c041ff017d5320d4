"""How a surface should move so that two photos agree: the gradient of local ZNCC through it.

Vu, Labatut, Pons, Keriven, "High Accuracy and Visibility-Consistent Dense Multiview Stereo", PAMI
2012, section 6.1. Photo j is reprojected into photo i through the surface; both are compared by
zero-mean normalised cross-correlation in a window around each pixel. Beyond the paper, the second
derivative of the score in the manner of Gauss and Newton is kept, which says how far to move; and
each window counts by what two noisy signals that correlate so well tell of their shift (Knapp,
Carter, "The Generalized Correlation Method for Estimation of Time Delay", 1976, eq. 26), so that
plain windows leave more to the surface's own smoothness than sharp ones.

Letters: i, j the two views; a, b pixels of photo i and of photo j seen through the surface; z depth
along the optical axis of i; q, p a pixel's ray and point in j's homogeneous pixel coordinates; u, v
column and row in j.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numba import njit

from pipeline.surface.zbuffer import Crop

WINDOW = 7  # pixels along a side
SEEN = 0.7  # share of a window that both views must see
NOISE = 0.01  # standard deviation of a photo's noise, in display units: plainer windows count less
CHANCE = 0.2  # score that windows of mere noise reach: it counts nothing
SURE = 0.98  # score above chance from which on a window counts no more


@dataclass(frozen=True)
class Sight:
    """What one view sees at one scale.

    photo: (h, w, 3) float32, grey and its derivatives by column and row; depth: (h, w), 0 where the
    view does not see the surface; front: (h, w) bool, pixels that see its outside, not too aslant;
    footprint: side of a pixel on the surface at unit depth.
    """

    crop: Crop
    photo: np.ndarray
    depth: np.ndarray
    front: np.ndarray
    footprint: float


def with_slopes(grey: np.ndarray) -> np.ndarray:
    """A picture (h, w) and its derivatives by column and row, (h, w, 3) float32."""
    grey = grey.astype(np.float32)
    kernel = np.array([[-0.5, 0, 0.5]], np.float32)
    across = cv2.filter2D(grey, -1, kernel, borderType=cv2.BORDER_REPLICATE)
    down = cv2.filter2D(grey, -1, kernel.T, borderType=cv2.BORDER_REPLICATE)
    return np.stack([grey, across, down], -1)


def pull(i: Sight, j: Sight) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """First and second derivative, by the depth of each pixel of i, of the sum of all windows'
    scores against j, weighted by `knowledge`; and the score itself, nan where there is none. (h, w)
    float32 each.

    A step of first / second is the one that Gauss and Newton would take for a pixel alone. The
    second derivative is that of half the squared distance of the normalised windows, which equals 1
    - ZNCC; it is never negative.
    """
    to_ray = j.crop.intrinsics @ j.crop.rotation @ i.crop.rotation.T
    ray = (to_ray @ np.linalg.inv(i.crop.intrinsics)).astype(np.float64)
    start = j.crop.intrinsics @ j.crop.shift - to_ray @ i.crop.shift
    moments, slope = _through(i.photo, i.depth, i.front, j.photo, j.depth, ray, start, j.footprint)

    size = (WINDOW, WINDOW)
    box = lambda image: cv2.boxFilter(
        image, -1, size, normalize=False, borderType=cv2.BORDER_CONSTANT
    )
    terms, score = _scored(moments, box(moments))
    first, second = _derivatives(moments, box(terms), slope)
    return first, second, score


@njit(nogil=True, fastmath=True, cache=True)
def _through(
    photo: np.ndarray,
    depth: np.ndarray,
    front: np.ndarray,
    other: np.ndarray,
    other_depth: np.ndarray,
    ray: np.ndarray,
    start: np.ndarray,
    footprint: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Photo j through the surface: moments (h, w, 6) of seen, a, a a, b, b b, a b, and db/dz
    (h, w). A point is seen by j if j's depth map is as far within three pixels' footprints.
    """
    h, w = depth.shape
    other_h, other_w = other_depth.shape
    moments = np.zeros((h, w, 6), np.float32)
    slope = np.zeros((h, w), np.float32)
    for row in range(h):
        for column in range(w):
            if not front[row, column]:
                continue
            z = depth[row, column]
            x = column + 0.5
            y = row + 0.5
            q0 = ray[0, 0] * x + ray[0, 1] * y + ray[0, 2]
            q1 = ray[1, 0] * x + ray[1, 1] * y + ray[1, 2]
            q2 = ray[2, 0] * x + ray[2, 1] * y + ray[2, 2]
            p2 = z * q2 + start[2]
            if p2 <= 0:
                continue
            u = (z * q0 + start[0]) / p2
            v = (z * q1 + start[1]) / p2
            left = int(np.floor(u - 0.5))
            top = int(np.floor(v - 0.5))
            if left < 0 or top < 0 or left >= other_w - 1 or top >= other_h - 1:
                continue

            s = np.float32(u - 0.5 - left)
            t = np.float32(v - 0.5 - top)
            near = 1e30
            for dy in range(2):
                for dx in range(2):
                    near = min(near, abs(other_depth[top + dy, left + dx] - p2))
            if near > 3 * footprint * p2:
                continue

            w00 = (1 - s) * (1 - t)
            w01 = s * (1 - t)
            w10 = (1 - s) * t
            w11 = s * t
            c00 = other[top, left]
            c01 = other[top, left + 1]
            c10 = other[top + 1, left]
            c11 = other[top + 1, left + 1]
            a = photo[row, column, 0]
            b = w00 * c00[0] + w01 * c01[0] + w10 * c10[0] + w11 * c11[0]
            across = w00 * c00[1] + w01 * c01[1] + w10 * c10[1] + w11 * c11[1]
            down = w00 * c00[2] + w01 * c01[2] + w10 * c10[2] + w11 * c11[2]
            slope[row, column] = (across * (q0 - u * q2) + down * (q1 - v * q2)) / p2
            moments[row, column, 0] = 1
            moments[row, column, 1] = a
            moments[row, column, 2] = a * a
            moments[row, column, 3] = b
            moments[row, column, 4] = b * b
            moments[row, column, 5] = a * b
    return moments, slope


@njit(nogil=True, fastmath=True, cache=True)
def knowledge(score: float) -> float:
    """How much a window with this ZNCC counts: z^2 / (1 - z^2) of the score z above chance, the
    inverse of the least variance that the estimate of a shift between two noisy signals can have
    (Knapp and Carter 1976).
    """
    z = min(max((score - CHANCE) / (1 - CHANCE), 0.0), SURE)
    return z * z / (1 - z * z)


@njit(nogil=True, fastmath=True, cache=True)
def _scored(moments: np.ndarray, sums: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Each window's ZNCC (h, w), nan where too little is seen, and its five terms in the
    derivatives (h, w, 5): those of a, of 1 beside a, of b, of 1 beside b, and of the second one.
    """
    h, w = moments.shape[:2]
    terms = np.zeros((h, w, 5), np.float32)
    score = np.full((h, w), np.nan, np.float32)
    fewest = SEEN * WINDOW * WINDOW
    for row in range(h):
        for column in range(w):
            count = sums[row, column, 0]
            if moments[row, column, 0] == 0 or count < fewest:
                continue
            mean_a = sums[row, column, 1] / count
            mean_b = sums[row, column, 3] / count
            variance_a = max(sums[row, column, 2] / count - mean_a * mean_a, 0.0) + NOISE * NOISE
            variance_b = max(sums[row, column, 4] / count - mean_b * mean_b, 0.0) + NOISE * NOISE
            both = np.sqrt(variance_a * variance_b)
            zncc = (sums[row, column, 5] / count - mean_a * mean_b) / both
            score[row, column] = zncc

            weight = knowledge(zncc)
            of_a = weight / (count * both)
            of_b = weight / (count * variance_b)
            terms[row, column, 0] = of_a
            terms[row, column, 1] = of_a * mean_a
            terms[row, column, 2] = of_b * zncc
            terms[row, column, 3] = of_b * zncc * mean_b
            terms[row, column, 4] = of_b
    return terms, score


@njit(nogil=True, fastmath=True, cache=True)
def _derivatives(
    moments: np.ndarray, sums: np.ndarray, slope: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """`pull` from the windows' terms summed over all windows that hold a pixel, (h, w, 5)."""
    h, w = slope.shape
    first = np.zeros((h, w), np.float32)
    second = np.zeros((h, w), np.float32)
    for row in range(h):
        for column in range(w):
            if moments[row, column, 0] == 0:
                continue
            a = moments[row, column, 1]
            b = moments[row, column, 3]
            t = sums[row, column]
            by_value = a * t[0] - t[1] - b * t[2] + t[3]
            first[row, column] = by_value * slope[row, column]
            second[row, column] = slope[row, column] ** 2 * t[4]
    return first, second
