"""How much a run's samples differ and how far the truth may be off them, for the page."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pipeline.base.images import linear_to_srgb
from pipeline.render.draw_metrics import COMMON_ERROR
from pipeline.render.samples import FEWEST, LEVEL, Spread, half_widths

KNOWN_TO = 0.02  # standard error of the samples' mean base colour, sRGB: five steps of 8 bits
MOST = 64


def color_facts(spread: Spread) -> dict:
    """How much the samples' base colours differ, sRGB: how many of them make the standard error of
    their mean KNOWN_TO, s^2 / KNOWN_TO^2 for a root mean square deviation of s over texels and
    channels, between FEWEST and MOST; and the half-widths of LEVEL's predictive interval at the
    median of the texels and channels and at HARD.
    """
    deviation = spread.color
    mean_square = float((deviation**2).mean())
    needed = int(np.clip(np.ceil(mean_square / KNOWN_TO**2), FEWEST, MOST))
    middle, hard = half_widths(deviation, spread.count)
    return {
        "samples_needed": needed,
        "spread": float(np.sqrt(mean_square)),
        "known_to": KNOWN_TO,
        "color_within": middle,
        "color_within_hard": hard,
        "common_error": COMMON_ERROR,
    }


def relit_facts(relit: Sequence[np.ndarray], brightness: float) -> dict:
    """The same half-widths of the samples' pixels under another light: relit, radiance (n, 3) of
    each under one of mean radiance 1; brightness: of the light that they are compared under. None
    for a single sample.
    """
    if len(relit) < FEWEST:
        return {}
    shown = [linear_to_srgb(brightness * pixels) for pixels in relit]
    middle, hard = half_widths(np.std(shown, axis=0, ddof=1), len(shown))
    return {"relit_within": middle, "relit_within_hard": hard}


def samples_words(found: dict, count: int) -> str:
    """Whether `count` samples are enough, in plain words, of `color_facts`."""
    needed = found["samples_needed"]
    verdict = "enough" if needed <= count else "too few"
    return (
        f"{count} samples are {verdict}: their base colours differ by {found['spread']:.3f} (sRGB, "
        f"root mean square), so {needed} give a mean that is known to {found['known_to']:.2f}."
    )


def weights_words(weights: np.ndarray, pixels: int) -> str:
    """How much every sample counts in the mean, in plain words, and why; pixels: of photos left
    out, that judged them.
    """
    if not pixels:
        return "All samples count alike in their mean: photos are too few to judge them by."
    *others, last = (f"{k} by {100 * share:.0f} %" for k, share in enumerate(weights))
    return (
        f"In their mean sample {', '.join(others)} and {last} counts: the mixture that predicts "
        "photos best that its base colours were not made from."
    )


def interval_words(found: dict) -> str:
    """How far the truth may be off the samples' mean, in plain words, of `color_facts` and
    `relit_facts`.
    """
    return (
        f"The true base colour is put within ±{found['color_within']:.2f} (sRGB) of the mean of "
        f"samples at half of the texels, within ±{found['color_within_hard']:.2f} at nine tenths "
        f"of them; the view under another light within ±{found['relit_within']:.2f} and "
        f"±{found['relit_within_hard']:.2f} ({100 * LEVEL:.0f} % intervals). They count by how "
        f"much the samples differ, and an error of {found['common_error']:.2f} that all have in "
        "common on scenes whose surface and truth are known. A wrong surface comes on top."
    )
