"""What the surface says of photos that differ in exposure or white balance, and of light that moves
with the camera. Asked where cameras were given: no points were matched then, of which
pipeline/photos/photometry.py and turntable.py ask it.

Cells of the texture take the points' place. They are less like points than matches are: coarse, and
on gloss and in hollows too, where matching finds little; but they are the whole surface. So gains
are judged by what they explain, and a moving light's course must also be steep. Figures of
development data, ten real and made scenes, 48 texels a side and at most 66 degrees from head-on:

- Of light that rests, a course over the azimuth explained up to .15 of the variance, with .05
  stops, or had up to .2 stops and explained .05; of a real turntable it explained .28 with .18
  stops, of a made one .46 with .5.
- Gains of photos whose exposure is right left at least .79 of the variance of log brightness, and
  .75 of that of colour; of a smooth metal .54, for each photo shows another part of the light in
  it. Divided out, those gains of .4 stops cost 18 dB under new light. Where exposure was off by one
  stop (standard deviation) gains left .09 to .34, and an error of .05 to .4 stops; where it was off
  by .3 stops, .1 to .75: what shading varies by more than exposure is left alone.
"""

from __future__ import annotations

import numpy as np

from pipeline.base.config import Poses
from pipeline.geometry.cameras import Rig, View
from pipeline.photos.photometry import DARK, gains
from pipeline.photos.readings import Readings
from pipeline.photos.turntable import LightMotion, check, motion_of

CELLS = 48  # along a side of the texture
LEAST_COSINE = 0.4  # between ray and normal; at the rim mesh, mask and blur err
LEAST_COURSE = 0.13  # stops
GREEN = 1
WITHOUT_POINTS = "transforms.json"  # source of cameras that come alone
LEFT = 0.5  # share of the variance that gains must leave at most: less than they explain
ENOUGH_PIXELS = 300_000  # over all photos


def cell_brightness(table: dict[str, np.ndarray], views: int) -> np.ndarray:
    """Mean log2 radiance (views, cells, 3) of every cell of the texture in every view, NaN where it
    shows no usable pixel. table: of make_observations (pipeline/render/observe.py). The result is
    dense, for there are at most CELLS^2 cells, however many pixels: 55 kB a view.
    """
    column, row = np.clip((table["uv"] * CELLS).astype(int), 0, CELLS - 1).T
    size = (views, CELLS * CELLS)
    key = np.ravel_multi_index((table["view"].astype(int), row * CELLS + column), size)
    usable = (table["rgb"] > DARK) & ~table["clipped"] & (table["cosine"] > LEAST_COSINE)[:, None]

    out = np.full((*size, 3), np.nan)
    for c in range(3):
        mine = usable[:, c]
        count = np.bincount(key[mine], minlength=views * CELLS * CELLS).reshape(size)
        logs = np.log2(table["rgb"][mine, c].astype(float))
        total = np.bincount(key[mine], logs, views * CELLS * CELLS).reshape(size)
        out[..., c][count > 0] = total[count > 0] / count[count > 0]
    return out[:, np.isfinite(out).any((0, 2))]


def surface_motion(
    brightness: np.ndarray, stops: np.ndarray, views: list[View], center: np.ndarray
) -> LightMotion:
    """Evidence from log2 radiance (views, cells, 3) less the photos' gains (views, 3)."""
    level = brightness[..., GREEN] - stops[:, GREEN, None]
    return motion_of(views, Readings.of(level), center, LEAST_COURSE)


def variance_left(level: np.ndarray, stops: np.ndarray) -> float:
    """Share of the variance of log2 brightness (views, cells, c), NaN where unknown, each cell less
    its mean over the views, that gains (views, c) leave. 1 where no cell is seen twice.
    """
    seen = np.isfinite(level)
    count = seen.sum(0)
    centred = lambda a: (a - np.where(seen, a, 0).sum(0) / np.maximum(count, 1))[seen & (count > 1)]

    whole = centred(level)
    rest = whole - centred(np.broadcast_to(stops[:, None], level.shape))
    square = (whole**2).sum()
    return float((rest**2).sum() / square) if square else 1.0


def worth_dividing(
    brightness: np.ndarray, stops: np.ndarray, fit: np.ndarray
) -> tuple[np.ndarray, dict]:
    """The part of log2 gains (views, 3) that explains what the photos show: brightness and white
    balance, each whole or not at all; and facts. brightness: log2 radiance (views, cells, 3); fit:
    (views,) bool, the photos by which it is judged.
    """
    mean, level = brightness.mean(2, keepdims=True), stops.mean(1, keepdims=True)
    left = variance_left(mean[fit], level[fit])
    left_of_colour = variance_left((brightness - mean)[fit], (stops - level)[fit])
    facts = {
        "exposure_left_unexplained": left,
        "exposure_matched": left < LEFT,
        "white_balance_left_unexplained": left_of_colour,
        "white_balance_matched": left_of_colour < LEFT,
    }
    return level * (left < LEFT) + (stops - level) * (left_of_colour < LEFT), facts


def surface_photometry(
    table: dict[str, np.ndarray], views: list[View], rig: Rig, where: str, settings: Poses
) -> tuple[np.ndarray, dict]:
    """log2 gains (views, 3) that photos are to be divided by, 0 where that is not asked for or they
    are not `worth_dividing`; and facts, `warnings` among them. table: of `views`.

    Raises InputError where the light moves with the camera and `moving_light` is not "accept".
    """
    brightness = cell_brightness(table, len(views))
    fit = np.array([v.split == "fit" for v in views])
    found = gains(brightness, fit)
    told = [v for v in views if v.split == "fit"]
    motion = surface_motion(brightness[fit], found[fit], told, rig.center)
    accept = settings.moving_light == "accept"
    warnings = check(motion, where, accept, rig.facts.get("out_of_focus", []))
    facts: dict = {"light_motion": motion.facts(), "warnings": warnings}
    if not settings.match_exposure:
        return np.zeros_like(found), facts

    stops, more = worth_dividing(brightness, found, fit)
    if stops.any():
        more["exposure_left_stops"] = {v.name: s.tolist() for v, s in zip(views, stops)}
    return stops, facts | more
