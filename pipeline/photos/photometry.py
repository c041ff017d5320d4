"""Brightness and white balance that differ between photos beyond what EXIF says, from matched
points.

A matched point is equally bright everywhere up to shading that changes with the view. With
y[v, p, c] the log2 radiance of point p in channel c of photo v, the gains are

    argmin over g, q of  sum r(y[v, p, c] - g[v, c] - q[p, c])   with   sum over v of g[v, c] = 0

by iteratively reweighted least squares, with r(e) = |e|. The constraint holds exactly in every
channel: the set as a whole changes neither brightness nor colour, whichever photos are dark or
blue.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from pipeline.base.images import read_exr, write_exr
from pipeline.geometry.cameras import View
from pipeline.photos.readings import Readings
from pipeline.photos.saturation import saturated

DARK = 0.01  # radiance (white = 1) below which noise rules
# Stops. Gains that spread less are left alone: shading that drifts along with the azimuth does as
# much. Real sets whose exposure is known show up to .64 (brass; .62 marble, .26 others), and up to
# .26 in one channel against the three's mean.
SAME = 0.6
SAME_COLOUR = 0.35
# Stops that differ from photo to photo (`erratic`). Brass shows .10, and .19 by every third of its
# photos; other sets whose exposure is right less; a marble head photographed in two sessions, a
# stop of daylight apart, .33.
SAME_BESIDE = 0.25
MIN_POINTS = 30  # matched points a photo needs for a gain of its own
ROUNDS = 20  # of reweighting
SMALLEST = 0.02  # stops; residuals below count as equally good


def point_brightness(views: list[View], folder: Path, points: dict) -> Readings:
    """log2 radiance (n, 3) of the points in the views that they were matched in, NaN where the
    pixel is dark in that channel or saturated.

    folder: where the views' pictures lie; points: see `sfm.sparse_points`.
    """
    owner = np.repeat(np.arange(len(points["xyz"])), np.diff(points["offsets"]))
    numbers = []
    values = []
    for k, view in enumerate(views):
        mine = owner[points["views"] == k]
        uv, depth = view.project(points["xyz"][mine])
        column, row = np.floor(uv).astype(int).T
        inside = (column >= 0) & (row >= 0) & (column < view.width) & (row < view.height)
        inside &= depth > 0

        photo = read_exr(folder / view.image)
        rgb = photo[row[inside], column[inside]]
        clipped = saturated(folder, view, photo)[row[inside], column[inside]]
        usable = (rgb > DARK) & ~clipped
        numbers.append(mine[inside])
        values.append(np.log2(rgb, out=np.full_like(rgb, np.nan), where=usable))
    return Readings(
        np.repeat(np.arange(len(views)), [len(some) for some in numbers]),
        np.concatenate(numbers),
        np.concatenate(values),
        len(views),
        len(points["xyz"]),
    )


def gains(brightness: Readings | np.ndarray, fit: np.ndarray | None = None) -> np.ndarray:
    """log2 gain (views, 3) of every photo and channel, from log2 radiance: readings (n, 3), or a
    small table (views, points, 3). Sums to zero over the photos. 0 for photos with too few points,
    or not linked to most others.

    fit: (views,) bool, the photos that say how bright points are; without it all do. The sum is
    over them, and each of the others is held against the points as they see them.
    """
    table = brightness if isinstance(brightness, Readings) else Readings.of(brightness)
    fit = np.ones(table.views, bool) if fit is None else fit
    return np.stack([channel_gains(table.channel(c), fit) for c in range(3)], -1)


def channel_gains(y: Readings, fit: np.ndarray) -> np.ndarray:
    """As `gains`, for one channel: known values (n,) -> (views,)."""
    out = np.zeros(y.views)
    enough = np.zeros(y.views, bool)
    enough[fit] = _linked(y.of_views(fit))
    if enough.sum() < 3:
        return out

    told = y.of_views(enough)
    twice = told.photos_of_points() >= 2
    told = told.of_points(twice)
    weight = np.ones(len(told.value))
    mean = lambda values: told.sum_of_points(weight * values) / told.sum_of_points(weight)
    for _ in range(ROUNDS):
        gain = _least_squares(told, weight)
        rest = told.less(gain).value
        rest = rest - mean(rest)[told.point]
        weight = 1 / np.maximum(np.abs(rest), SMALLEST)

    out[enough] = gain - gain.mean()
    level = mean(told.less(out[enough]).value)
    others = y.of_points(twice)
    for k in np.flatnonzero(~fit):
        own = others.chosen(others.view == k)
        if len(own.value) >= MIN_POINTS:
            out[k] = np.median(own.value - level[own.point])
    return out


def _matrix(y: Readings, values: np.ndarray) -> sparse.csr_matrix:
    """(views, points), sparse, of values (n,)."""
    return sparse.csr_matrix((values, (y.view, y.point)), shape=(y.views, y.points))


def _linked(y: Readings) -> np.ndarray:
    """Photos (views,) bool with MIN_POINTS points that others see too, in the largest group that
    common points link.
    """
    shared = y.photos_of_points()[y.point] >= 2
    enough = y.sum_of_views(shared) >= MIN_POINTS
    if not enough.any():
        return enough
    some = y.of_views(enough)
    seen = _matrix(some, np.ones(len(some.value)))
    label = connected_components(seen @ seen.T, directed=False)[1]
    enough[np.flatnonzero(enough)[label != np.bincount(label).argmax()]] = False
    return enough


def _least_squares(y: Readings, weight: np.ndarray) -> np.ndarray:
    """argmin over g (with sum 0) and q of sum weight (y - g - q)^2; (n,) -> g (views,).

    With q eliminated the normal matrix is a graph's Laplacian, whose null vector is a common gain;
    a rank-one term takes its place.
    """
    share = weight / y.sum_of_points(weight)[y.point]
    weighted = weight * y.value
    matrix = np.diag(y.sum_of_views(weight)) - (_matrix(y, share) @ _matrix(y, weight).T).toarray()
    right = y.sum_of_views(weighted) - y.sum_of_views(share * y.sum_of_points(weighted)[y.point])
    return np.linalg.solve(matrix + matrix.diagonal().mean() / len(matrix), right)


def spread(stops: np.ndarray) -> float:
    """Typical size of gains: 1.48 times the median magnitude, a normal distribution's deviation."""
    return float(1.4826 * np.median(np.abs(stops)))


def erratic(level: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """How much the gains (views,) of photos differ from that of the photo taken from nearest beside
    them, over sqrt 2: the size of an error that each photo has for itself. What drifts as the
    camera goes round is hardly in it. directions (views, 3): unit, from the object to the cameras.
    """
    nearness = directions @ directions.T
    np.fill_diagonal(nearness, -np.inf)
    return (level - level[nearness.argmax(1)]) / np.sqrt(2)


def worth_dividing(
    stops: np.ndarray, fit: np.ndarray | None = None, known_from: np.ndarray | None = None
) -> tuple[np.ndarray, dict]:
    """The part of log2 gains (views, 3) that is more than shading does: brightness and white
    balance, each whole or not at all; and facts. fit: (views,) bool, the photos by which it is
    judged; without it all.

    known_from: directions (views, 3), where the photos' exposures are known and divided out. An
    object lit from one side is darker all the way round on the other, and gains that follow its
    shading are no exposure's (brass: .64 stops). Then it is judged by what is `erratic`.
    """
    level = stops.mean(1, keepdims=True)
    colour = stops - level
    told = np.ones(len(stops), bool) if fit is None else fit
    of_level, same = spread(level[told]), SAME
    if known_from is not None:
        of_level, same = spread(erratic(level[told, 0], known_from[told])), SAME_BESIDE
    of_colour = spread(np.abs(colour).max(1)[told])
    facts = {
        "exposure_spread_stops": of_level,
        "exposure_matched": of_level > same,
        "white_balance_spread_stops": of_colour,
        "white_balance_matched": of_colour > SAME_COLOUR,
    }
    return level * facts["exposure_matched"] + colour * facts["white_balance_matched"], facts


def match_exposure(
    views: list[View], folder: Path, found: np.ndarray, known_from: np.ndarray | None = None
) -> tuple[list[View], dict]:
    """Divide the photos under `folder` by their log2 gains (views, 3) where those are
    `worth_dividing`; new views and facts.
    """
    fit = np.array([v.split == "fit" for v in views])
    stops, facts = worth_dividing(found, fit, known_from)
    if not stops.any():
        return views, facts

    out = []
    for view, stop in zip(views, stops):
        gain = 2.0**stop
        picture = read_exr(folder / view.image) / gain.astype(np.float32)
        write_exr(folder / view.image, picture, half=True)
        out.append(replace(view, clip_level=float(view.clip_level / gain.max())))
    return out, facts | {"exposure_left_stops": {v.name: s.tolist() for v, s in zip(views, stops)}}
