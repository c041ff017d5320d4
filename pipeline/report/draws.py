"""How much a run's samples differ and how far the truth may be off them, for the page."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pipeline.base.images import linear_to_srgb
from pipeline.geometry.mesh_io import Mesh, unit
from pipeline.render.draw_metrics import COMMON_ERROR
from pipeline.render.samples import (
    FEWEST,
    KNOWN_TO,
    LEVEL,
    Spread,
    half_widths,
    mean_square,
    samples_needed,
)
from pipeline.render.surface_texels import SurfaceTexels
from pipeline.surface.raster import texel_faces

SLANTED = 0.4  # mean height of unit normals below which a surface faces the sides
SAME = 0.005  # deviation of roughness below which samples have the same
FEW = 0.005  # of the surface: so little that no photo shows is not worth a sentence


def color_facts(spread: Spread, texels: SurfaceTexels) -> dict:
    """How much the samples' base colours differ where photos show the surface, sRGB; how many of
    them are needed (`samples_needed`); and the half-widths of LEVEL's predictive interval at the
    median of the texels and channels and at HARD.
    """
    square = mean_square(spread, texels)
    middle, hard = half_widths(spread.color[texels.seen], spread.count)
    return {
        "samples_needed": samples_needed(square),
        "spread": float(np.sqrt(square)),
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
        f"The mean counts sample {', '.join(others)} and {last}: the mixture that best predicts "
        "photos which its base colours were not made from."
    )


def side_of(mesh: Mesh, texels: SurfaceTexels) -> str:
    """Where photos would have to be taken from to show most of what none shows, +y being up."""
    face = texel_faces(mesh, len(texels.seen))[0]
    unseen = np.unique(face[texels.surface & ~texels.seen], return_counts=True)
    a, b, c = (mesh.vertices[mesh.faces[unseen[0], k]] for k in range(3))
    up = np.average(unit(np.cross(b - a, c - a))[:, 1], weights=unseen[1])
    if abs(up) < SLANTED:
        return "other sides"
    return "above" if up > 0 else "below"


def unseen_words(mesh: Mesh, texels: SurfaceTexels) -> str:
    """How much of the surface no photo shows, and what is there; empty for hardly any."""
    if texels.unseen_share < FEW:
        return ""
    return (
        f"No photo shows {100 * texels.unseen_share:.0f} % of the surface, grey in pictures of "
        f"spread; most of it photos from {side_of(mesh, texels)} would show. Every sample has "
        "colours there that join on to what photos show around: nothing is known of it."
    )


def alike_words(spread: Spread, tested: bool) -> str:
    """That agreement on roughness is a choice, where all samples have the same; tested: whether
    gloss had to be asked for by photos (`refine.gloss`). Empty elsewhere.
    """
    if not tested or spread.roughness.max() > SAME:
        return ""
    return (
        "All samples have the same roughness: the simplest that predicts photos left out as well "
        "as any. Photos do not contradict it, but that samples agree does not make it certain."
    )


def interval_words(found: dict) -> str:
    """How far the truth may be off the samples' mean, in plain words, of `color_facts` and
    `relit_facts`.
    """
    return (
        f"The true base colour is put within ±{found['color_within']:.2f} (sRGB) of the mean of "
        "samples at half of the texels that photos show, within "
        f"±{found['color_within_hard']:.2f} at nine tenths of them; the view under another light "
        f"within ±{found['relit_within']:.2f} and ±{found['relit_within_hard']:.2f} "
        f"({100 * LEVEL:.0f} % intervals). They count by how much the samples differ, and an error "
        f"of {found['common_error']:.2f} that all have in common on scenes whose surface and truth "
        "are known. A wrong surface comes on top."
    )
