"""The samples of a finished run, by how much they differ, and how far the truth may be off them.

They are read one after another and let go: at 4096 texels a side each has 340 MB.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from pipeline.base.images import linear_to_srgb, luminance
from pipeline.render.draw_metrics import COMMON_ERROR, half_width
from pipeline.render.renderer import GLASS, Explanation, head_on, ior_of
from pipeline.render.stacking import LeftOut, weights
from pipeline.render.surface_texels import SurfaceTexels

MEAN = "mean"  # what the samples' mean is called among an asset's variants
FEWEST = 2  # samples that say anything of spread
KNOWN_TO = 0.02  # standard error of the samples' mean base colour, sRGB: five steps of 8 bits
MOST = 64  # samples that are ever said to be needed
LEVEL = 0.8  # share of the true values that an interval is meant to hold
HARD = 0.9  # quantile of the texels that is said beside the median
DARKEST = 1e-4  # radiance, or luminance of base colours, below which all is black
DIM = 0.02  # base colour, below which the differences of samples are no matter of their light
AGREED = 1e-3  # weight of the samples that take a texel for another stuff, that is for none

Parts = tuple[np.ndarray, ...]


class Samples(Sequence):
    """The refined samples in their folders, each read whenever it is asked for."""

    def __init__(self, folders: Sequence[Path]):
        self.folders = folders

    @classmethod
    def of(cls, work: Path, count: int) -> Samples:
        """Those of a scene's work folder."""
        return cls([work / "refine" / str(k) for k in range(count)])

    def __len__(self) -> int:
        return len(self.folders)

    def __getitem__(self, k: Any) -> Any:
        return Explanation.load(self.folders[k])

    def __iter__(self) -> Iterator[Explanation]:
        return map(Explanation.load, self.folders)

    @cached_property
    def judged(self) -> list[LeftOut]:
        """What is known of each by photos left out. Raises InputError."""
        return [LeftOut.load(folder) for folder in self.folders]

    @cached_property
    def texels(self) -> SurfaceTexels:
        """Those of base colours, the same for all samples. Raises InputError."""
        return SurfaceTexels.load(self.folders[0])

    @cached_property
    def weights(self) -> np.ndarray:
        """How much each counts in their mean (N,): stacking.py; one by itself counts in full,
        judged or not. Raises InputError.
        """
        return weights(self.judged) if len(self) >= FEWEST else np.ones(len(self))


@dataclass(frozen=True)
class Spread:
    """How much the samples differ: unbiased standard deviations over `count` of them.

    color (t, t, 3): of the base colour, sRGB; roughness, metallic (t', t'); light (h, 2h, 3): of
    the log of radiance over its mean.
    """

    count: int
    color: np.ndarray
    roughness: np.ndarray
    metallic: np.ndarray
    light: np.ndarray

    @classmethod
    def of(cls, samples: Sequence[Explanation]) -> Spread | None:
        """None for a single sample, which says nothing of spread."""
        count = len(samples)
        if count < FEWEST:
            return None
        mean = [part / count for part in _sum(_compared(x) for x in samples)]
        square = lambda x: tuple((part - m) ** 2 for part, m in zip(_compared(x), mean))
        deviation = (np.sqrt(part / (count - 1)) for part in _sum(square(x) for x in samples))
        return cls(count, *deviation)


def mean_of(samples: Sequence[Explanation], weight: np.ndarray) -> Explanation | None:
    """The posterior mean, as far as the samples tell, in which every sample counts `weight` (N,), 1
    together (`Samples.weights`): means of radiance and of the reflectance head-on, of roughness
    weighted by what a sample mirrors, of base colours by `_mean_color`, and of metallic weighted by
    base colour. None for a single sample.

    It explains no photo by itself, as every sample does, but where samples differ its errors are
    the smaller ones (docs/method.md). A surface of base colour a and metallic m reflects (1 - m) a
    diffusely and about m a in its highlights: with linear means of a and metallic sum(m a) / sum(a)
    both are the samples' means. The plain mean of m is too diffuse, for what is taken for a metal
    is taken for the brighter in base colour.
    """
    if len(samples) < FEWEST:
        return None
    counted = (
        tuple(np.float32(share) * part for part in _averaged(x))
        for x, share in zip(samples, weight, strict=True)
    )
    light, color, log_color, is_metal, of_gloss, gloss, of_metal, metal, reflectance = _sum(counted)
    ior = round(ior_of(float(reflectance[0])), 4)  # what samples have in common stays what it is
    color = _mean_color(color, log_color, is_metal)
    return Explanation(light, color, gloss / of_gloss, metal / of_metal, ior=ior)


def _mean_color(color: np.ndarray, log_color: np.ndarray, is_metal: np.ndarray) -> np.ndarray:
    """Base colours (t, t, 3) from their linear means, those of the log of what `_averaged` has of
    them, and the share of the samples (s, s) that take a texel for metal.

    A photo shows base colour times light, so that where one sample has the brighter light it has
    the darker paint, and linear means of both are too bright together: their harmonic mean would be
    right for a matt surface under the mean light, the linear one under another light. The geometric
    mean lies between. Only where samples agree about metal, for else bright paint is not the other
    side of a dim light.
    """
    size = color.shape[1::-1]
    share = cv2.resize(is_metal, size, interpolation=cv2.INTER_NEAREST)[..., None]
    agree = np.minimum(share, 1 - share) < AGREED
    geometric = np.maximum(np.exp(log_color) - DIM, 0)
    return np.where(agree, geometric, color).astype(np.float32)


def _averaged(x: Explanation) -> Parts:
    """What `mean_of` sums: light, base colour, the log of that and DIM, whether it is metal, of
    roughness and metallic each its weight and that times it, and the reflectance head-on. Roughness
    counts by what is mirrored: without a highlight it means nothing.
    """
    mirrors = head_on(x.ior) / head_on(GLASS)
    metal = cv2.resize(x.metallic, x.roughness.shape[::-1], interpolation=cv2.INTER_AREA)
    shiny = mirrors * (1 - metal) + metal + np.float32(DARKEST)
    bright = luminance(x.base_color).astype(np.float32)
    weight = cv2.resize(bright, x.metallic.shape[::-1], interpolation=cv2.INTER_AREA) + DARKEST
    reflectance = np.array([head_on(x.ior)])
    is_metal = (x.metallic >= 0.5).astype(np.float32)
    colors = x.base_color, np.log(x.base_color + np.float32(DIM)), is_metal
    return x.light, *colors, shiny, shiny * x.roughness, weight, weight * x.metallic, reflectance


def _compared(x: Explanation) -> Parts:
    """What samples are compared by: the arrays of `Spread`, in order."""
    log_light = np.log(np.maximum(x.light, DARKEST) / x.light.mean())
    return linear_to_srgb(x.base_color), x.roughness, x.metallic, log_light


def _sum(parts: Iterator[Parts]) -> Parts:
    """Sums of the arrays, in order."""
    total = tuple(part.copy() for part in next(parts))
    for more in parts:
        for sums, part in zip(total, more):
            sums += part
    return total


def mean_square(spread: Spread, texels: SurfaceTexels) -> float:
    """Of the base colours' deviations, sRGB, over the channels of texels that photos show."""
    return float((spread.color[texels.seen] ** 2).mean())


def samples_needed(square: float) -> int:
    """How many samples make the standard error of their mean base colour KNOWN_TO, s^2 / KNOWN_TO^2
    for a mean square deviation s^2 (`mean_square`); between FEWEST and MOST.
    """
    return int(np.clip(np.ceil(square / KNOWN_TO**2), FEWEST, MOST))


def half_widths(deviation: np.ndarray, count: int) -> tuple[float, float]:
    """Of LEVEL's intervals of `count` samples' sRGB values, what all miss together counted, at the
    median and at HARD of the deviations.
    """
    quantiles = np.quantile(deviation, [0.5, HARD])
    middle, hard = half_width(quantiles, count, LEVEL, COMMON_ERROR)
    return float(middle), float(hard)


def asset_facts(spread: Spread | None, texels: SurfaceTexels) -> dict:
    """What an asset says of itself: the share of its surface that no photo shows; within how much
    of the samples' mean the true base colour is put, sRGB, at half of the other texels and at HARD
    of them, and the share that such intervals are to hold, these not for a single sample.
    """
    unseen = {"unseen_share": round(texels.unseen_share, 4)}
    if spread is None:
        return unseen
    middle, hard = half_widths(spread.color[texels.seen], spread.count)
    return unseen | {
        "base_color_within": round(middle, 3),
        "base_color_within_hard": round(hard, 3),
        "interval": LEVEL,
    }
