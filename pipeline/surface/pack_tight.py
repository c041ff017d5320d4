"""Packing flat charts into one square without a library, texel by texel (`atlas.packer: tight`).

Charts are placed one after the other, largest first, each in one of four turns at the lowest free
place; the scale is the largest at which all find one. A chart is a set of horizontal runs of
texels, padding included; where a run meets a taken texel, the search jumps past it.
"""

from __future__ import annotations

import cv2
import numpy as np
from numba import njit

from pipeline.base.errors import InputError
from pipeline.surface.pack import Chart, chart_area, turned, upright

TRIES = 6  # of the scale
DENSEST = 0.85  # share of the square that charts cover in the first try


def tightly_packed(charts: list[Chart], resolution: int, padding: int) -> list[np.ndarray]:
    """The charts' coordinates (k, 2) in [0, 1]^2, no two nearer than `padding` texels.

    charts: each the coordinates (k, 2) and triangles (m, 3) of one chart, all in one unit. Raises
    InputError where they do not fit even at a tenth of the scale that their area asks for.
    """
    boxed = [upright(uv) for uv, _ in charts]
    area = sum(chart_area(uv, corner) for uv, (_, corner) in zip(boxed, charts))
    most = (DENSEST * resolution**2 / area) ** 0.5
    low = 0.1 * most
    best = _placed(boxed, charts, low, resolution, padding)
    if best is None:
        raise InputError(
            f"{len(charts)} charts do not fit into {resolution} x {resolution} texels",
            "atlas",
            "raise atlas.resolution, or lower mesh.faces or atlas.padding",
        )
    high = most
    for _ in range(TRIES):
        scale = (low * high) ** 0.5 if low < 0.5 * most else 0.5 * (low + high)
        found = _placed(boxed, charts, scale, resolution, padding)
        if found is None:
            high = scale
        else:
            low = scale
            best = found
    return best


def _placed(
    boxed: list[np.ndarray],
    charts: list[Chart],
    scale: float,
    resolution: int,
    padding: int,
) -> list[np.ndarray] | None:
    """All charts at `scale` texels per unit, or None where one finds no place."""
    margin = (padding + 1) // 2 + 1
    order = sorted(range(len(boxed)), key=lambda k: -float(np.ptp(boxed[k], axis=0).sum()))
    taken = np.full((resolution, resolution), resolution, np.int32)
    out: list[np.ndarray] = [np.empty(0)] * len(boxed)
    for k in order:
        low = (resolution + 1, 0, 0)
        for turn in range(4):
            uv = scale * turned(boxed[k], turn)
            uv = uv - uv.min(0) + margin
            runs, height, width = _runs(uv, charts[k][1], margin)
            row, column = _lowest(taken, runs, height, width, low[0])
            if row >= 0 and row + height < low[0]:
                low = (row + height, row, column)
                chosen = (uv, runs)
        if low[0] > resolution:
            return None
        uv, runs = chosen
        _take(taken, runs, low[1], low[2])
        out[k] = (uv + [low[2], low[1]]) / resolution
    return out


def _runs(uv: np.ndarray, corner: np.ndarray, margin: int) -> tuple[np.ndarray, int, int]:
    """Runs (r, 3) of (row, first column, column after the last) that the chart and `margin` texels
    around it take, by rows; height and width of all.
    """
    width, height = (int(side) + 1 for side in np.ceil(uv.max(0)) + margin)
    picture = np.zeros((height, width), np.uint8)
    at = np.round(uv * 16).astype(np.int32)  # of a sixteenth of a texel
    for triangle in at[corner] - 8:
        cv2.fillConvexPoly(picture, triangle, 1, lineType=cv2.LINE_8, shift=4)
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * margin - 1,) * 2)
    padded = cv2.dilate(picture, kernel)
    step = np.diff(padded.astype(np.int8), axis=1, prepend=0, append=0)
    rows, first = np.nonzero(step == 1)
    _, after = np.nonzero(step == -1)
    return np.stack([rows, first, after], -1).astype(np.int32), height, width


@njit(cache=True)
def _lowest(
    taken: np.ndarray, runs: np.ndarray, height: int, width: int, below: int
) -> tuple[int, int]:
    """Row and column of the lowest free place, leftmost of these; (-1, -1) where there is none that
    ends before row `below`. taken (n, n): column of the next taken texel at or after each.
    """
    size = len(taken)
    for row in range(min(size - height, below - 1 - height) + 1):
        column = 0
        while column + width <= size:
            jump = 0
            for r in range(len(runs)):
                start = column + runs[r, 1]
                next_taken = taken[row + runs[r, 0], start]
                if next_taken < column + runs[r, 2]:
                    jump = next_taken + 1 - start
                    break
            if jump == 0:
                return row, column
            column += jump
    return -1, -1


@njit(cache=True)
def _take(taken: np.ndarray, runs: np.ndarray, row: int, column: int) -> None:
    """Mark the runs as taken."""
    for r in range(len(runs)):
        line = taken[row + runs[r, 0]]
        first = column + runs[r, 1]
        after = column + runs[r, 2]
        for k in range(first, after):
            line[k] = k
        k = first - 1
        while k >= 0 and line[k] > first:
            line[k] = first
            k -= 1
