"""Work of the point estimate: looks at every texel, at no more texels than its purpose needs.

Samplers take from it the base colours of regions and the light's level. Texels finer than a photo's
pixels add nothing to either, nor do more than FINEST a side, nor steps beyond those after which
every texel has been looked at LOOKS times (docs/experiments.md has what more and fewer bring).
"""

from __future__ import annotations

import numpy as np

from pipeline.base.config import Fit
from pipeline.posterior.choose.texture_size import SMALLEST

FINEST = 128  # texels a side, as in the preset `draft`: draws are no better from 256
LOOKS = 30  # at a texel: draws are worse from 15 on, and no better from 60
LEAST_STEPS = 120  # as in the preset `draft`: the light needs them, however few texels there are
LEAST_PIXELS = 1024  # a step: with fewer the light's slope is noise


def fit_work(distance: np.ndarray, settings: Fit) -> tuple[dict, dict]:
    """{"texture", "steps", "pixels"} of the fit, none above what is configured, and the evidence.
    distance (k,): ground sampling distances on the atlas, as `texture_size` takes them.
    """
    needed = 1 / float(np.median(distance))
    filled = max(SMALLEST, 2 ** int(np.floor(np.log2(needed))))
    side = min(filled, FINEST, settings.texture)
    looks = LOOKS * side**2
    steps = min(settings.steps, max(LEAST_STEPS, -(-looks // settings.pixels)))
    pixels = min(settings.pixels, max(LEAST_PIXELS, -(-looks // steps)))
    return {"texture": side, "steps": steps, "pixels": pixels}, {
        "texels_for_one_each_pixel": needed,
        "looks_at_a_texel": steps * pixels / side**2,
    }
