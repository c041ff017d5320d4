"""The samples of a finished run, by how much they differ, and how many a scene needs.

They are read one after another and let go: at 4096 texels a side each has 340 MB.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.base.images import linear_to_srgb
from pipeline.render.draw_metrics import predictive_reach
from pipeline.render.renderer import Explanation

KNOWN_TO = 0.02  # standard error of the samples' mean base colour, sRGB: five steps of 8 bits
FEWEST = 2
MOST = 64
LEVEL = 0.8  # share of the true values that an interval is meant to hold
HARD = 0.9  # quantile of the texels that is said beside the median


class Samples(Sequence):
    """The refined samples in a scene's work folder, each read whenever it is asked for."""

    def __init__(self, work: Path, count: int):
        self.folders = [work / "refine" / str(k) for k in range(count)]

    def __len__(self) -> int:
        return len(self.folders)

    def __getitem__(self, k: Any) -> Any:
        return Explanation.load(self.folders[k])

    def __iter__(self) -> Iterator[Explanation]:
        return map(Explanation.load, self.folders)


Parts = tuple[np.ndarray, ...]


def deviations(
    samples: Sequence[Explanation], of: Callable[[Explanation], Parts], ddof: int = 0
) -> Parts:
    """Standard deviation over samples of each array that `of` makes of one. ddof: 1 for the
    unbiased variance.
    """
    count = len(samples)
    mean = [part / count for part in _sum(of(x) for x in samples)]
    square = lambda x: tuple((part - m) ** 2 for part, m in zip(of(x), mean))
    return tuple(np.sqrt(part / (count - ddof)) for part in _sum(square(x) for x in samples))


def _sum(parts: Iterator[Parts]) -> Parts:
    """Sums of the arrays, in order."""
    total = tuple(part.copy() for part in next(parts))
    for more in parts:
        for sums, part in zip(total, more):
            sums += part
    return total


def color_spread(samples: Sequence[Explanation]) -> dict:
    """How much the samples' base colours differ, sRGB: how many of them make the standard error of
    their mean KNOWN_TO, s^2 / KNOWN_TO^2 for a root mean square deviation (n - 1) of s over texels
    and channels, between FEWEST and MOST; and the half-widths of LEVEL's predictive interval at the
    median of the texels and channels and at HARD. Empty for a single sample, which says nothing of
    spread.
    """
    if len(samples) < FEWEST:
        return {}
    (deviation,) = deviations(samples, lambda x: (linear_to_srgb(x.base_color),), ddof=1)
    spread = float(np.sqrt((deviation**2).mean()))
    needed = int(np.clip(np.ceil((spread / KNOWN_TO) ** 2), FEWEST, MOST))
    middle, hard = predictive_reach(len(samples), LEVEL) * np.quantile(deviation, [0.5, HARD])
    return {
        "samples_needed": needed,
        "spread": spread,
        "known_to": KNOWN_TO,
        "color_within": float(middle),
        "color_within_hard": float(hard),
    }


def samples_words(found: dict, count: int) -> str:
    """Whether `count` samples are enough, in plain words, of `color_spread`."""
    needed = found["samples_needed"]
    verdict = "enough" if needed <= count else "too few"
    return (
        f"{count} samples are {verdict}: their base colours differ by {found['spread']:.3f} (sRGB, "
        f"root mean square), so {needed} give a mean that is known to {found['known_to']:.2f}."
    )


def interval_words(found: dict) -> str:
    """How far the true base colours may be off the samples' mean, in plain words."""
    return (
        f"By how much the samples differ, the true base colour is put within "
        f"±{found['color_within']:.2f} (sRGB) of their mean at half of the texels, within "
        f"±{found['color_within_hard']:.2f} at nine tenths of them ({100 * LEVEL:.0f} % "
        "intervals). That leaves out what all samples miss together: a wrong surface, or a light "
        "that all take for too bright or too dim."
    )
