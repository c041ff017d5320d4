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
# stops: gains that spread less are left alone, shading on a glossy table makes nearly as much
SAME = 0.25
MIN_POINTS = 30  # matched points a photo needs for a gain of its own


def point_brightness(views: list[View], image_of, points: dict) -> np.ndarray:
    """log2 luminance (views, points) where a view's track holds the point and the pixel is usable,
    else NaN.
    """
    owner = np.repeat(np.arange(len(points["xyz"])), np.diff(points["offsets"]))
    out = np.full((len(views), len(points["xyz"])), np.nan, np.float32)
    for k, view in enumerate(views):
        mine = owner[points["views"] == k]
        uv, depth = view.project(points["xyz"][mine])
        column, row = np.floor(uv).astype(int).T
        ok = (depth > 0) & (column >= 0) & (row >= 0) & (column < view.width) & (row < view.height)
        rgb = image_of(view)[row[ok], column[ok]]
        good = (luminance(rgb) > DARK) & (rgb < 0.9 * view.clip_level).all(1)
        out[k, mine[ok][good]] = np.log2(luminance(rgb[good]))
    return out


def gains(brightness: np.ndarray, rounds: int = 30) -> np.ndarray:
    """log2 gain (views,) of every photo by alternating medians; 0 where a photo has too few
    points.
    """
    shared = brightness[:, np.isfinite(brightness).sum(0) >= 2]
    enough = np.isfinite(shared).sum(1) >= MIN_POINTS
    out = np.zeros(len(brightness))
    if enough.sum() < 3:
        return out
    rows = shared[enough]
    rows, g = rows[:, np.isfinite(rows).sum(0) >= 2], np.zeros(len(rows))
    for _ in range(rounds):
        g = np.nanmedian(rows - np.nanmedian(rows - g[:, None], axis=0), axis=1)
        g -= np.median(g)
    out[enough] = g
    return out


def spread(g: np.ndarray) -> float:
    """Typical size of gains in stops: 1.48 times the median magnitude."""
    return float(1.4826 * np.median(np.abs(g)))


def match_exposure(views: list[View], folder: Path, points: dict) -> tuple[list[View], dict]:
    """Divide the photos under `folder` by their gains if those spread by more than SAME; new views
    and facts.
    """
    g = (
        gains(point_brightness(views, lambda v: read_exr(folder / v.image), points))
        if len(points["xyz"])
        else np.zeros(len(views))
    )
    facts = {"exposure_spread_stops": spread(g), "exposure_matched": spread(g) > SAME}
    if not facts["exposure_matched"]:
        return views, facts
    out = []
    for view, stops in zip(views, g):
        gain = float(2.0**stops)
        write_exr(folder / view.image, read_exr(folder / view.image) / gain, half=True)
        out.append(replace(view, clip_level=view.clip_level / gain))
    return out, facts | {"exposure_left_stops": {v.name: float(s) for v, s in zip(views, g)}}
