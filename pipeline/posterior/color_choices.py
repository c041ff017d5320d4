"""What photos decide of a base colour map: how sharp it is, how metal counts, how bright the light.

Each is what predicts every EVERY-th view best from a map of the others. Where cameras and surface
are right to a fraction of a texel the map is sharp. On metal it may be hardly sharp at all: what a
light that is not quite right lacks in a mirrored direction is not to become the colour of the texel
that mirrors it.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np

from pipeline.base.images import linear_to_srgb
from pipeline.posterior.base_color import USUAL, ColorSolver, Sharpness
from pipeline.posterior.map_pixels import MapPixels
from pipeline.posterior.problem import ALBEDO_MAX, SHADE
from pipeline.posterior.shading import Shading
from pipeline.posterior.textures import fill

# smoothest first
CHOICES = (
    *(Sharpness(around, 0) for around in (256.0, 64.0, 16.0, 4.0)),
    USUAL,
    Sharpness(1.0, 1),
    Sharpness(0.5, 3),
)
TRIED_FIRST = 3  # of them
METAL = 0.5  # metallic from which on a pixel or texel is of metal
BRIGHTER = (1.0, 1.2, 1.45, 1.75, 2.1)  # factors of the light that are tried
# part of the error that a brighter light must save: no eye sees less
CLEAR_GAIN = 0.01
# part of the pixels that must lie where a base colour is at its limit, before a brighter is tried
AT_LIMIT = 0.002
# part of them from which on matt colours at the limit speak against a light by themselves: of 77
# opaque measured materials (physicallybased.info, CC0) gold, silver and Spectralon alone reach .99
TOO_MANY = 0.03


def solver_for(pixels: MapPixels, shading: Shading, begin: np.ndarray) -> ColorSolver:
    """The solver that counts metal as predicts photos best, by maps of the USUAL sharpness; evenly,
    where no view judges.
    """
    solver = ColorSolver(pixels, shading, begin, even=shows_metal(shading))
    return counted_best(solver, USUAL)[0] if judges_metal(solver) else solver


def shows_metal(shading: Shading) -> bool:
    return bool((shading.metallic > METAL).any())


def judges_metal(solver: ColorSolver) -> bool:
    """Whether there is metal, and views that can judge how it counts."""
    return shows_metal(solver.shading) and solver.judges is not None


def counted_best(solver: ColorSolver, sharpness: Sharpness | None) -> tuple[ColorSolver, Sharpness]:
    """The solver that counts metal by the log or evenly, whichever explains the judging views
    better by a score's error, and how sharp: as said, or the sharpest that holds of either.
    """
    tried = sorted((solver, solver.otherwise), key=lambda one: one.even)
    chosen = [(one, sharpness or sharpest_that_holds(one)) for one in tried]
    return min(chosen, key=lambda pair: error_by_other_views(*pair))


def error_by_other_views(solver: ColorSolver, sharpness: Sharpness) -> float:
    """Mean squared sRGB error of the judging views, by a map from the others."""
    color, weight = solver.by_other_views
    if sharpness != USUAL:
        color = solver.mean(weight, solver.photo(solver.picture(color)), sharpness)
    picture = solver.picture(color)
    return squared_srgb_error(picture[solver.judges], solver.photo(picture)[solver.judges])


def sharpest_that_holds(solver: ColorSolver) -> Sharpness:
    """Of CHOICES the one whose map, made from the other views, explains every EVERY-th best; there
    all pixels count, as they do in a score. The error falls towards the best one from either side,
    so that those beyond a worse one are not tried.
    """
    if solver.judges is None:
        return USUAL

    color, weight = solver.by_other_views
    photo = solver.photo(solver.picture(color))

    def error(choice: int) -> float:
        picture = solver.picture(solver.mean(weight, photo, CHOICES[choice]))
        return float((log_error(picture, photo)[solver.judges] ** 2).mean())

    return CHOICES[lowest(error, TRIED_FIRST, len(CHOICES))]


def lowest(error: Callable[[int], float], start: int, count: int) -> int:
    """The number under `count` at which `error`, which falls and then rises, is least: the search
    goes down from `start`, and asks for each error once at most.
    """
    error = lru_cache(error)
    way = 1 if start + 1 < count and error(start + 1) < error(start) else -1
    best = start
    while 0 <= best + way < count and error(best + way) < error(best):
        best += way
    return best


def log_error(picture: np.ndarray, photo: np.ndarray) -> np.ndarray:
    """Relative errors (n, 3) of a picture."""
    return np.log((np.maximum(picture, 0) + SHADE) / (photo + SHADE))


def squared_srgb_error(picture: np.ndarray, photo: np.ndarray) -> float:
    """Mean squared difference of sRGB values, from linear ones (n, 3)."""
    srgb = lambda image: linear_to_srgb(np.clip(image, 0, 1))
    return float(((srgb(picture) - srgb(photo)) ** 2).mean())


def at_limit(color: np.ndarray) -> np.ndarray:
    """Which (n) of the colours (n, 3) have a channel at ALBEDO_MAX."""
    return np.asarray((color >= 0.99 * ALBEDO_MAX).any(1))


def brighter_light(solver: ColorSolver) -> float:
    """Factor >= 1 by which the solver's light must be brighter for base colours <= 1 to explain
    the photos. Those of BRIGHTER are tried until fewer than AT_LIMIT of the pixels show a colour at
    its limit. Of those whose colours, made from the other views, explain every EVERY-th as well as
    the best one's, up to CLEAR_GAIN of the error, it is the least under which fewer than TOO_MANY
    of the pixels show such a colour on what is no metal; the brightest, where there is none.

    A light that is too dim would be made up for by colours above 1, which there are not. The error
    is a score's, squared, of sRGB values: it counts what is far too dark, as parts at the limit
    are, and a mean of |log| hardly does.
    """
    if solver.judges is None:
        return 1.0

    matt = solver.shading.metallic[:, 0] <= METAL  # gold and silver are at the limit by nature
    errors: list[float] = []
    few_matt: list[bool] = []
    for factor in BRIGHTER:
        tried = solver.under(factor)
        errors.append(error_by_other_views(tried, USUAL))
        color, _ = tried.by_other_views
        limited = at_limit(solver.pixels.of(color))
        few_matt.append((limited & matt).mean() < TOO_MANY)
        if limited.mean() < AT_LIMIT:
            break
    good = np.flatnonzero(np.array(errors) * (1 - CLEAR_GAIN) <= min(errors))
    enough = [k for k in good if few_matt[k]]
    return BRIGHTER[enough[0] if enough else good[-1]]


def color_map(solver: ColorSolver, sharpness: Sharpness | None = None) -> tuple[np.ndarray, dict]:
    """Base colour map (t, t, 3) by robust means. Without `sharpness` it is chosen, and how metal
    counts anew.

    Texels that no pixel falls on take the nearest seen one's colour. Facts: `loss`, the mean
    squared relative error of the picture that the solver's `begin` makes; the sharpness.
    """
    if sharpness is None and judges_metal(solver):
        solver, sharpness = counted_best(solver, None)
    elif sharpness is None:
        sharpness = sharpest_that_holds(solver)
    color, weight, loss = solver.robust()
    photo = solver.photo(solver.picture(color))
    color = solver.mean(weight, photo, sharpness)
    return fill(color, solver.pixels.seen), {
        "loss": loss,
        "around": sharpness.around,
        "passes": sharpness.passes,
    }
