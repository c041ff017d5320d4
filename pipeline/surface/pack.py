"""Packing flat charts into one square with xatlas.

xatlas places chart after chart, largest first, where the page that holds all so far stays smallest,
on a page that begins as wide as the square. It does not turn charts here: its own turn swaps u and
v, which mirrors. So the quarter turns are sought around it: on a coarse page many turns of all
charts are tried, each kept where the page becomes smaller, and the best is packed on the page
itself.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from pipeline.base.apart import Call, apart
from pipeline.base.errors import InputError

Chart = tuple[np.ndarray, np.ndarray]  # coordinates (k, 2) and triangles (m, 3)

COARSE = 512  # texels along the page on which turns are sought
DENSITY = 0.6  # share of the page that charts are taken to cover at first
MOST_TRIES = 48  # of turns
WORK = 8000  # charts times tries: with many charts, how each lies matters less
ANEW = 1 / 3  # share of the tries that turn all charts anew
CHANGED = 0.05  # share of the charts that the other tries turn
FITS = 12  # tries of the scale on the page itself at most
LEAST = 0.1  # of the scale that the charts' area asks for: below, they are taken not to fit
WIDE = 0.98  # of the square: how wide the page is when it begins; it may grow by some texels
ENOUGH = 0.995  # of a scale that is too large: closer is not sought
NEAR = 0.97  # of the scale that the coarse page promised: good enough on the page itself


@dataclass(frozen=True)
class Page:
    """Charts for a page of so many texels.

    boxed: coordinates (k, 2) of every chart; corners: its triangles (m, 3); inner: texels along the
    page without its margin; half: texels around a chart.
    """

    boxed: list[np.ndarray]
    corners: list[np.ndarray]
    inner: int
    half: int
    placed_by_xatlas: Call

    def laid(self, scale: float, turns: np.ndarray) -> tuple[list[np.ndarray], tuple[int, int]]:
        """Every chart where it lies after so many quarter turns (c,), and the page's sides in u and
        v. scale: texels per unit.
        """
        lying = [scale * turned(uv, quarters) for uv, quarters in zip(self.boxed, turns)]
        return self.placed_by_xatlas(lying, self.corners, self.half, int(WIDE * self.inner))

    def sides(self, scale: float, turns: np.ndarray) -> tuple[int, int]:
        return self.laid(scale, turns)[1]

    @property
    def coarse(self) -> Page:
        """The same page with few texels, in which a chart is placed in an eighth of the time."""
        side = min(COARSE, self.inner)
        half = int(np.ceil(self.half / (self.inner + 2 * self.half) * side))
        return replace(self, inner=side, half=half)

    @property
    def area(self) -> float:
        """The charts', in square units."""
        return sum(chart_area(uv, corner) for uv, corner in zip(self.boxed, self.corners))


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
    page = Page(boxed, [corner for _, corner in charts], inner, half, placed_by_xatlas)
    generator = np.random.default_rng(0)
    turns, scale = _best_turns(page, generator)

    best = None
    longest = max(float(np.ptp(uv, axis=0).max()) for uv in boxed)  # turns leave it as it is
    scale = promised = min(scale, (inner - 1) / max(longest, 1e-30))
    least = LEAST * (resolution**2 / page.area) ** 0.5
    fits, too_large, step = least, np.inf, ENOUGH
    for _ in range(FITS):
        placed, sides = page.laid(scale, turns)
        if max(sides) <= inner:
            best, fits = placed, scale
        else:
            too_large = scale
        if fits > ENOUGH * too_large:
            break
        asked = scale * inner / float(np.prod(sides)) ** 0.5
        if scale == fits:
            scale = max(asked, scale / ENOUGH)
        else:
            scale = min(asked, scale * step)
            step **= 2  # the page's area says little where one chart alone makes it wide
        if not fits < scale < too_large:
            scale = 0.5 * (fits + too_large)
    if best is None:
        raise InputError(
            f"{len(charts)} charts do not fit into {resolution} x {resolution} texels",
            "atlas",
            "raise atlas.resolution, or lower mesh.faces or atlas.padding",
        )

    # a scale may fit where a smaller one does not: where less fits than the coarse page promised,
    # other turns are tried half the way up, on the page itself if they fit on the coarse one
    coarse = page.coarse
    for _ in range(_tries(len(boxed))):
        if fits > NEAR * promised:
            break
        scale, others = (fits * promised) ** 0.5, some_turned(turns, generator)
        if max(coarse.sides(scale * coarse.inner / inner, others)) > coarse.inner:
            continue
        placed, sides = page.laid(scale, others)
        if max(sides) <= inner:
            best, fits, turns = placed, scale, others
    return [(uv + half) / resolution for uv in best]


def _best_turns(page: Page, generator: np.random.Generator) -> tuple[np.ndarray, float]:
    """Quarter turns of every chart (c,) with which the page is smallest, sought on the coarse one,
    and the scale in texels per unit at which it has the page's own area.
    """
    boxed, coarse = page.boxed, page.coarse
    scale = (DENSITY * coarse.inner**2 / page.area) ** 0.5
    tries = _tries(len(boxed))

    along = np.array([int(np.ptp(uv[:, 0]) < np.ptp(uv[:, 1])) for uv in boxed])
    least = np.inf
    best = turns = along
    for k in range(tries):
        size = _size(coarse.sides(scale, turns), coarse.inner)
        if size <= least:
            best = turns
            least = size
        upside_down = along + 2 * generator.integers(0, 2, len(boxed))
        anyhow = generator.integers(0, 4, len(boxed))
        others = some_turned(best, generator)
        turns = others if k >= ANEW * tries else upside_down if k % 2 == 0 else anyhow
    return best, scale * page.inner / least**0.5


def _tries(charts: int) -> int:
    return int(np.clip(WORK / charts, 4, MOST_TRIES))


def some_turned(turns: np.ndarray, generator: np.random.Generator) -> np.ndarray:
    """Turns (c,) of which CHANGED are others, one at least."""
    changed = generator.random(len(turns)) < CHANGED
    changed[generator.integers(len(turns))] = True
    return np.where(changed, generator.integers(0, 4, len(turns)), turns)


def _size(sides: tuple[int, int], coarse: int) -> float:
    """The area that a page of these sides in u and v takes of a square: its own, for charts of
    another scale would make it as wide and less high; that of the square around it where it has
    grown wider than it began.
    """
    return float(np.prod(sides)) if sides[0] <= coarse else float(max(sides)) ** 2


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
