"""Packing flat charts into one square with xatlas.

xatlas places chart after chart, largest first, where the page that holds all so far stays smallest
and most square. It does not turn charts here: its own turn swaps u and v, which mirrors. So the
quarter turns are sought around it: on a coarse page many turns of all charts are tried, each kept
where the page becomes smaller, and the best is packed on the page itself.
"""

from __future__ import annotations

import cv2
import numpy as np

from pipeline.base.apart import Call, apart
from pipeline.base.errors import InputError

Chart = tuple[np.ndarray, np.ndarray]  # coordinates (k, 2) and triangles (m, 3)

COARSE = 512  # texels along the page on which turns are sought
DENSITY = 0.6  # share of the page that charts are taken to cover at first
MOST_TRIES = 48  # of turns
WORK = 4000  # charts times tries: with many charts, how each lies matters less
RANDOM = 1 / 3  # share of the tries in which every chart is turned, not a few of the best try's
CHANGED = 0.2  # share of the charts that the other tries turn
FITS = 12  # tries of the scale on the page itself at most
LEAST = 0.1  # of the scale that the charts' area asks for: below, they are taken not to fit
ENOUGH = 0.995  # of the page's side: closer is not sought


def packed(charts: list[Chart], resolution: int, padding: int) -> list[np.ndarray]:
    """The charts' coordinates (k, 2) in [0, 1]^2, no two nearer than `padding` texels, and as many
    between two at opposite edges of the square. None is mirrored and all have one scale.

    charts: each the coordinates (k, 2) and triangles (m, 3) of one chart, all in one unit. Raises
    InputError where they do not fit.
    """
    with apart("pipeline.surface.xatlas_page", "placed") as placed_by_xatlas:
        return _packed(charts, resolution, padding, placed_by_xatlas)


def _packed(
    charts: list[Chart], resolution: int, padding: int, placed_by_xatlas: Call
) -> list[np.ndarray]:
    half = (padding + 1) // 2
    inner = resolution - 2 * half
    boxed = [upright(uv) for uv, _ in charts]
    corners = [corner for _, corner in charts]
    turns, scale = _best_turns(boxed, corners, inner, half / resolution, placed_by_xatlas)
    lying = [turned(uv, quarters) for uv, quarters in zip(boxed, turns)]

    best = None
    area = sum(chart_area(*chart) for chart in charts)
    least = LEAST * (resolution**2 / area) ** 0.5
    for _ in range(FITS):
        if scale < least:
            break
        placed, side = placed_by_xatlas([scale * uv for uv in lying], corners, half)
        if side <= inner:
            best = placed
        if ENOUGH * inner <= side <= inner or (best is not None and side > inner):
            break
        scale *= 0.999 * inner / side
    if best is None:
        raise InputError(
            f"{len(charts)} charts do not fit into {resolution} x {resolution} texels",
            "atlas",
            "raise atlas.resolution, or lower mesh.faces or atlas.padding",
        )
    return [(uv + half) / resolution for uv in best]


def _best_turns(
    boxed: list[np.ndarray],
    corners: list[np.ndarray],
    inner: int,
    margin: float,
    placed_by_xatlas: Call,
) -> tuple[np.ndarray, float]:
    """Quarter turns of every chart (c,) with which the page is smallest, and the scale in texels
    per unit at which its side is `inner`. margin: texels around a chart, as share of the page.
    """
    coarse = min(COARSE, inner)
    half = int(np.ceil(margin * coarse))
    area = sum(chart_area(uv, corner) for uv, corner in zip(boxed, corners))
    scale = (DENSITY * coarse**2 / area) ** 0.5
    tries = int(np.clip(WORK / len(boxed), 4, MOST_TRIES))
    generator = np.random.default_rng(0)

    best = np.array([int(np.ptp(uv[:, 0]) < np.ptp(uv[:, 1])) for uv in boxed])
    least = np.inf
    turns = best
    for k in range(tries):
        scaled = [scale * turned(uv, quarters) for uv, quarters in zip(boxed, turns)]
        side = placed_by_xatlas(scaled, corners, half)[1]
        if side <= least:
            best = turns
            least = side
        any_turns = generator.integers(0, 4, len(boxed))
        changed = generator.random(len(boxed)) < CHANGED
        changed[generator.integers(len(boxed))] = True
        turns = any_turns if k < RANDOM * tries else np.where(changed, any_turns, best)
    return best, scale * inner / least


def chart_area(uv: np.ndarray, corner: np.ndarray) -> float:
    """The area of a chart's triangles."""
    a, b, c = (uv[corner[:, k]] for k in range(3))
    cross = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    return float(0.5 * np.abs(cross).sum())


def upright(uv: np.ndarray) -> np.ndarray:
    """The chart turned so that its bounding box is smallest."""
    _, _, degrees = cv2.minAreaRect(uv.astype(np.float32))
    angle = np.radians(degrees)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return uv @ turn


def turned(uv: np.ndarray, quarters: int) -> np.ndarray:
    """u, v turned by quarters of a circle."""
    for _ in range(quarters):
        uv = np.stack([-uv[:, 1], uv[:, 0]], -1)
    return uv
