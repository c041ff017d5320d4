"""The base colour map that the photos show, given what the light gives to every pixel.

L = a D + S is linear in the base colour a, so a texel's colour is a = sum w (y - S) / sum w D over
the pixels y that see it. Few pixels are noisy and may all show one highlight: a texel therefore
also counts some pixels' worth of what the texels around it show, coarse to fine over a pyramid.

A dielectric's errors are relative ones: a pixel counts by the log's. What a metal mirrors is the
light, and a drawn light is smoother than the true one: D lacks in lamps what it has too much of
beside them. By logs what is dark counts most, there D is too bright, and the metal comes out too
dark. Where all pixels of a metal count the same, errors of either sign cancel; it is done where
that predicts photos better.

A mean over pixels is blurred by their size. Adding what the mean leaves over, again and again
(back-projection), sharpens it; that helps where cameras and surface are right to a fraction of a
texel and harms everywhere else. How sharp the map may be is what predicts photos best that it was
not made from. On metal that may be hardly at all: what a light that is not quite right lacks in a
mirrored direction is not to become the colour of the texel that mirrors it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import cv2
import numpy as np

from pipeline.base.images import linear_to_srgb
from pipeline.posterior.map_pixels import MapPixels, single
from pipeline.posterior.pixel_loops import weigh_into
from pipeline.posterior.problem import ALBEDO_MAX, SHADE
from pipeline.posterior.shading import Shading
from pipeline.posterior.textures import fill

COARSEST = 32  # side of the pyramid's smallest map
# errors of logs at which a pixel loses half its weight, one solve after the other: the first must
# not lock in what a mean over all pixels says, the last must not forget what is merely noisy
CONTRADICTIONS = (1.0, 1.0, 0.7, 0.7)
EVERY = 5  # one view of so many judges how sharp the map may be, and how bright the light
BRIGHTER = (1.0, 1.2, 1.45, 1.75, 2.1)  # factors of the light that are tried
# part of the error that a brighter light must save: no eye sees less
CLEAR_GAIN = 0.01
# part of the pixels that must lie where a base colour is at its limit, before a brighter is tried
AT_LIMIT = 0.02
METAL = 0.5  # metallic from which on a pixel shows metal


@dataclass(frozen=True)
class Sharpness:
    """around: pixels that a texel's surroundings count as, at every level of the pyramid; passes:
    back-projections after the mean.
    """

    around: float
    passes: int


USUAL = Sharpness(2.0, 0)
# smoothest first
CHOICES = (
    *(Sharpness(around, 0) for around in (256.0, 64.0, 16.0, 4.0)),
    USUAL,
    Sharpness(1.0, 1),
    Sharpness(0.5, 3),
)
TRIED_FIRST = 3  # of them


@dataclass
class TexelSums:
    """Sums over the pixels of every texel of a map: of w (y - S) and of w D, both (t, t, 3); and
    how many pixels there are, (t, t, 1).
    """

    color: np.ndarray
    shading: np.ndarray
    pixels: np.ndarray

    def halved(self) -> TexelSums:
        """The map of half the side."""
        total = lambda image: np.add.reduce([image[i::2, j::2] for i in (0, 1) for j in (0, 1)])
        return TexelSums(total(self.color), total(self.shading), total(self.pixels))


def larger(image: np.ndarray, side: int) -> np.ndarray:
    """A map (t, t, 3) at the size (side, side, 3)."""
    return cv2.resize(image.astype(np.float32), (side, side)).reshape(side, side, 3)


def coarse_to_fine(sums: TexelSums, around: float) -> np.ndarray:
    """Colours (t, t, 3): every level's means, with the next coarser level's colour counted as
    `around` pixels. Where no pixel is, the coarser level's.
    """
    levels = [sums]
    while levels[-1].pixels.shape[0] % 2 == 0 and levels[-1].pixels.shape[0] > COARSEST:
        levels.append(levels[-1].halved())

    total = lambda image: image.sum((0, 1), keepdims=True)
    whole = TexelSums(*(total(image) for image in (sums.color, sums.shading, sums.pixels)))
    color = whole.color / np.maximum(whole.shading, 1e-9)
    shading = whole.shading / np.maximum(whole.pixels, 1e-9)  # of one pixel, around each texel
    for level in reversed(levels):
        side = level.pixels.shape[0]
        color = larger(color, side)
        shading = larger(shading, side)

        weight = around * shading
        color = (level.color + weight * color) / np.maximum(level.shading + weight, 1e-9)
        shading = (level.shading + shading) / (level.pixels + 1)
    return color


def shared_between_photos(pixels: MapPixels, shading: Shading) -> Shading:
    """The shading with D as a map where the surface is no metal.

    A dielectric's D is the light that falls on the surface, the same for every photo, while its
    estimates in single photos have the path tracer's noise: on garden they differ by 12 % from
    their mean, which costs .7 dB. What a metal reflects moves with the view.
    """
    sums = TexelSums(
        pixels.onto(pixels.cosine * shading.scaled),
        np.repeat(pixels.onto(pixels.cosine), 3, 2),
        pixels.count,
    )
    common = pixels.of(coarse_to_fine(sums, USUAL.around))
    metallic = shading.metallic
    scaled = (1 - metallic) * common + metallic * shading.scaled
    return replace(shading, scaled=scaled.astype(np.float32))


def weighed(
    picture: np.ndarray, photo: np.ndarray, known: np.ndarray, contradiction: float = np.inf
) -> tuple[np.ndarray, float]:
    """The weights (n, 3) and the mean squared relative error of `weigh_into`."""
    weight = np.empty_like(photo)
    loss = weigh_into(picture, photo, known, contradiction, SHADE, weight)
    return weight, loss


class ColorSolver:
    """Base colour maps for one shading of the observed pixels, from `begin` (t, t, 3)."""

    def __init__(
        self, pixels: MapPixels, shading: Shading, begin: np.ndarray, even: bool | None = None
    ):
        """even: whether all pixels of a metal count the same; what predicts photos best, where it
        is not said.
        """
        self.pixels = pixels
        self.shading = shading
        self.begin = begin
        if even is not None:
            self.even = even

    def under(self, factor: float) -> ColorSolver:
        """The same under a light brighter by a factor."""
        if factor == 1:
            return self
        return ColorSolver(self.pixels, self.shading.under(factor), self.begin, self.even)

    def picture(self, color: np.ndarray) -> np.ndarray:
        """Radiance (n, 3) of all pixels."""
        scaled = self.pixels.of(color) * self.shading.scaled
        return (scaled + self.shading.rest).astype(np.float32)

    def photo(self, picture: np.ndarray) -> np.ndarray:
        """What the photos say (n, 3); where they are saturated, the larger of it and `picture`."""
        observations = self.pixels.observations
        seen = observations.rgb
        return np.where(observations.clipped, np.maximum(seen, picture), seen)

    def mean(self, weight: np.ndarray, photo: np.ndarray, sharpness: Sharpness) -> np.ndarray:
        """Colours (t, t, 3) of the photos (n, 3), pixels weighted by (n, 3)."""
        pixels, side = self.pixels, self.pixels.size
        lit = pixels.onto(weight * self.shading.scaled)
        count = pixels.onto(weight[:, :1] > 0)
        color = np.zeros((side, side, 3), np.float32)
        for _ in range(1 + sharpness.passes):
            left = pixels.left_over(color, self.shading.scaled, self.shading.rest, photo, weight)
            color = color + coarse_to_fine(TexelSums(left, lit, count), sharpness.around)
            color = np.clip(color, 0, ALBEDO_MAX).astype(np.float32)
        return color

    def robust(self, unseen: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray, float]:
        """Usual colours (t, t, 3), the pixels' weights (n, 3), and the mean squared relative error
        of the picture that `begin` makes. Pixels `unseen` (n,) have weight 0.

        Weights forget pixels which other views contradict (Cauchy's, Holland and Welsch 1977):
        occlusion edges, slightly wrong cameras, highlights in the wrong place.
        """
        color = self.begin
        known = self.pixels.cosine[:, 0]
        if unseen is not None:
            known = np.where(unseen, np.float32(0), known)
        losses: list[float] = []
        for contradiction in CONTRADICTIONS:
            picture = self.picture(color)
            photo = single(self.photo(picture))
            # the first solve trusts all pixels: its errors are those of `begin`
            doubt = contradiction if losses else np.inf
            weight, loss = weighed(picture, photo, known, doubt)
            if self.even:
                weight *= self.evened(weighed(picture, photo, np.ones_like(known))[0])
            losses.append(loss)
            color = self.mean(weight, photo, USUAL)
        return color, weight, losses[0]

    @cached_property
    def judges(self) -> np.ndarray | None:
        """Which pixels (n,) are of every EVERY-th view; None where those are all views or none."""
        judge = self.pixels.observations.view % EVERY == 0
        return None if judge.all() or not judge.any() else judge

    def evened(self, by_log: np.ndarray) -> np.ndarray:
        """Factors (n, 3) of weights by the log that make all pixels of a metal count the same."""
        metallic = self.shading.metallic
        return (1 - metallic) + metallic * self.usual_weight / by_log

    @cached_property
    def usual_weight(self) -> np.ndarray:
        """Mean weight by the log (n, 3) around every pixel's place on the surface, in all photos of
        it, at the colours `begin`.
        """
        pixels, picture = self.pixels, self.picture(self.begin)
        ones = np.ones_like(pixels.cosine)
        by_log, _ = weighed(picture, single(self.photo(picture)), ones[:, 0])
        sums = TexelSums(pixels.onto(by_log), np.repeat(pixels.count, 3, 2), pixels.count)
        return pixels.of(coarse_to_fine(sums, USUAL.around))

    @cached_property
    def even(self) -> bool:
        """Whether all pixels of a metal count the same, or by the log as others do: what explains
        every EVERY-th view better from the other views, by maps of the USUAL sharpness. The same,
        where no view judges.
        """
        if not self.shows_metal:
            return False
        return self.judges is None or self.weighed_best(USUAL)[0].even

    @property
    def shows_metal(self) -> bool:
        return bool((self.shading.metallic > METAL).any())

    def weighed_best(self, sharpness: Sharpness | None) -> tuple[ColorSolver, Sharpness]:
        """By the log or evenly, whichever explains the judging views better by a score's error, and
        how sharp: as said, or the sharpest that holds of either.
        """
        tried = [ColorSolver(self.pixels, self.shading, self.begin, even) for even in (False, True)]
        chosen = [(solver, sharpness or solver.sharpest_that_holds()) for solver in tried]
        return min(chosen, key=lambda pair: pair[0].error_by_other_views(pair[1]))

    def error_by_other_views(self, sharpness: Sharpness) -> float:
        """Mean squared sRGB error of the judging views, by a map from the others."""
        color, weight = self.by_other_views
        if sharpness != USUAL:
            color = self.mean(weight, self.photo(self.picture(color)), sharpness)
        picture = self.picture(color)
        return squared_srgb_error(picture[self.judges], self.photo(picture)[self.judges])

    @cached_property
    def by_other_views(self) -> tuple[np.ndarray, np.ndarray]:
        """`robust` colours and weights without the pixels that judge."""
        color, weight, _ = self.robust(self.judges)
        return color, weight

    def sharpest_that_holds(self) -> Sharpness:
        """Of CHOICES the one whose map, made from the other views, explains every EVERY-th best;
        there all pixels count, as they do in a score. The error falls towards the best one from
        either side, so that those beyond a worse one are not tried.
        """
        if self.judges is None:
            return USUAL

        color, weight = self.by_other_views
        photo = self.photo(self.picture(color))

        def error(choice: int) -> float:
            picture = self.picture(self.mean(weight, photo, CHOICES[choice]))
            return float((log_error(picture, photo)[self.judges] ** 2).mean())

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


def share_at_limit(color: np.ndarray) -> float:
    """Part of colours (n, 3) with a channel at ALBEDO_MAX."""
    return float((color >= 0.99 * ALBEDO_MAX).any(1).mean())


def brighter_light(solver: ColorSolver) -> float:
    """Factor >= 1 by which the solver's light must be brighter for base colours <= 1 to explain
    the photos. Those of BRIGHTER are tried until fewer than AT_LIMIT of the pixels show a colour at
    its limit. Of them it is the least whose colours, made from the other views, explain every
    EVERY-th as well as the best one's, up to CLEAR_GAIN of the error.

    A light that is too dim would be made up for by colours above 1, which there are not. The error
    is a score's, squared, of sRGB values: it counts what is far too dark, as parts at the limit
    are, and a mean of |log| hardly does.
    """
    judge = solver.judges
    if judge is None:
        return 1.0

    errors: list[float] = []
    for factor in BRIGHTER:
        tried = solver.under(factor)
        color, _ = tried.by_other_views
        picture = tried.picture(color)
        errors.append(squared_srgb_error(picture[judge], tried.photo(picture)[judge]))
        if share_at_limit(solver.pixels.of(color)) < AT_LIMIT:
            break
    good_enough = np.array(errors) * (1 - CLEAR_GAIN) <= min(errors)
    return BRIGHTER[int(np.argmax(good_enough))]


def color_map(solver: ColorSolver, sharpness: Sharpness | None = None) -> tuple[np.ndarray, dict]:
    """Base colour map (t, t, 3) by robust means. Without `sharpness` it is chosen.

    Texels that no pixel falls on take the nearest seen one's colour. Facts: `loss`, the mean
    squared relative error of the picture that the solver's `begin` makes; the sharpness.
    """
    if sharpness is None and solver.shows_metal and solver.judges is not None:
        solver, sharpness = solver.weighed_best(None)
    elif sharpness is None:
        sharpness = solver.sharpest_that_holds()
    color, weight, loss = solver.robust()
    photo = solver.photo(solver.picture(color))
    color = solver.mean(weight, photo, sharpness)
    return fill(color, solver.pixels.seen), {
        "loss": loss,
        "around": sharpness.around,
        "passes": sharpness.passes,
    }
