"""Brightness that differs between photos beyond what EXIF says, from matched points.

A matched point is equally bright everywhere up to shading that changes with the view; over many
points of object and surroundings the median difference of a photo to the points' own median is the
photo's gain. Log gains have median zero. White balance is left alone: in one channel, few points
are bright enough to tell.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from pipeline.base.images import luminance, read_exr, write_exr
from pipeline.geometry.cameras import View

DARK = 0.01  # radiance (white = 1) below which noise rules
SAME = 0.25  # stops; gains that spread less are left alone: a glossy table's shading does as much
MIN_POINTS = 30  # matched points a photo needs for a gain of its own


def point_brightness(views: list[View], image_of, points: dict) -> np.ndarray:
    """log2 luminance (views, points), NaN where a view was not matched to the point or its pixel is
    dark or saturated.

    image_of: view -> linear picture (h, w, 3); points: see `sfm.sparse_points`.
    """
    owner = np.repeat(np.arange(len(points["xyz"])), np.diff(points["offsets"]))
    out = np.full((len(views), len(points["xyz"])), np.nan, np.float32)
    for k, view in enumerate(views):
        mine = owner[points["views"] == k]
        uv, depth = view.project(points["xyz"][mine])
        column, row = np.floor(uv).astype(int).T
        inside = (column >= 0) & (row >= 0) & (column < view.width) & (row < view.height)
        inside &= depth > 0

        rgb = image_of(view)[row[inside], column[inside]]
        usable = (luminance(rgb) > DARK) & (rgb < 0.9 * view.clip_level).all(1)
        out[k, mine[inside][usable]] = np.log2(luminance(rgb[usable]))
    return out


def gains(brightness: np.ndarray, rounds: int = 30) -> np.ndarray:
    """log2 gain (views,) of every photo by alternating medians; 0 where a photo has too few
    points.
    """
    in_pairs = brightness[:, np.isfinite(brightness).sum(0) >= 2]
    enough = np.isfinite(in_pairs).sum(1) >= MIN_POINTS
    out = np.zeros(len(brightness))
    if enough.sum() < 3:
        return out

    rows = in_pairs[enough]
    rows = rows[:, np.isfinite(rows).sum(0) >= 2]
    gain = np.zeros(len(rows))
    for _ in range(rounds):
        point = np.nanmedian(rows - gain[:, None], axis=0)
        gain = np.nanmedian(rows - point, axis=1)
        gain -= np.median(gain)

    out[enough] = gain
    return out


def spread(stops: np.ndarray) -> float:
    """Typical size of gains: 1.48 times the median magnitude, a normal distribution's deviation."""
    return float(1.4826 * np.median(np.abs(stops)))


def match_exposure(views: list[View], folder: Path, points: dict) -> tuple[list[View], dict]:
    """Divide the photos under `folder` by their gains if those spread by more than SAME; new views
    and facts.
    """
    stops = np.zeros(len(views))
    if len(points["xyz"]):
        stops = gains(point_brightness(views, lambda v: read_exr(folder / v.image), points))
    facts = {"exposure_spread_stops": spread(stops), "exposure_matched": spread(stops) > SAME}
    if not facts["exposure_matched"]:
        return views, facts

    out = []
    for view, stop in zip(views, stops):
        gain = float(2.0**stop)
        write_exr(folder / view.image, read_exr(folder / view.image) / gain, half=True)
        out.append(replace(view, clip_level=view.clip_level / gain))
    return out, facts | {"exposure_left_stops": {v.name: float(s) for v, s in zip(views, stops)}}
