"""How many samples a scene needs, by how much they differ."""

from __future__ import annotations

import numpy as np

from pipeline.base.images import linear_to_srgb
from pipeline.render.renderer import Explanation

KNOWN_TO = 0.02  # standard error of the samples' mean base colour, sRGB: five steps of 8 bits
FEWEST = 2
MOST = 64


def spread_of(samples: list[Explanation]) -> float:
    """Root mean square over texels and channels of the standard deviation (n - 1) of the samples'
    base colour, sRGB.
    """
    colors = np.stack([linear_to_srgb(x.base_color) for x in samples])
    return float(np.sqrt(colors.var(0, ddof=1).mean()))


def samples_needed(samples: list[Explanation]) -> dict:
    """How many samples make the standard error of their mean base colour KNOWN_TO, s^2 / KNOWN_TO^2
    for a spread of s, between FEWEST and MOST; and the evidence. Empty for a single sample, which
    says nothing of spread.
    """
    if len(samples) < FEWEST:
        return {}
    spread = spread_of(samples)
    needed = int(np.clip(np.ceil((spread / KNOWN_TO) ** 2), FEWEST, MOST))
    return {"samples_needed": needed, "spread": spread, "known_to": KNOWN_TO}


def samples_words(found: dict, count: int) -> str:
    """The suggestion in plain words, of `samples_needed` from `count` samples."""
    needed = found["samples_needed"]
    verdict = "enough" if needed <= count else "too few"
    return (
        f"{count} samples are {verdict}: their base colours differ by {found['spread']:.3f} (sRGB, "
        f"root mean square), so {needed} give a mean that is known to {found['known_to']:.2f}. "
        "More are made with `samples: N`."
    )
