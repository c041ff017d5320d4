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
texel and harms everywhere else (color_choices.py).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from pipeline.posterior.map_pixels import MapPixels, single
from pipeline.posterior.map_pyramid import TexelSums, coarse_to_fine
from pipeline.posterior.pixel_loops import doubt_into, secants_into
from pipeline.posterior.problem import ALBEDO_MAX, SHADE
from pipeline.posterior.shading import Shading

# errors of logs at which a pixel loses half its weight, one solve after the other: the first must
# not lock in what a mean over all pixels says, the last must not forget what is merely noisy
CONTRADICTIONS = (1.0, 1.0, 0.7, 0.7)
EVERY = 5  # one view of so many judges what the others made


@dataclass(frozen=True)
class Sharpness:
    """around: pixels that a texel's surroundings count as, at every level of the pyramid; passes:
    back-projections after the mean.
    """

    around: float
    passes: int


USUAL = Sharpness(2.0, 0)


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
    """What a photo's difference from a picture, both (n, 3), counts, (n, 3): that of the log
    (`secants_into`), where pixels are known (n,) and are not contradicted (`doubt_into`); and the
    mean squared relative error.
    """
    shade, weight = np.float32(SHADE), np.empty_like(photo)
    logs = log_above(picture, shade), log_above(photo, shade)
    values = [array.ravel() for array in (picture, photo, *logs, weight)]
    total = secants_into(*values, shade)
    doubt_into(*logs, known, np.float32(contradiction), weight)
    return weight, total / max(photo.size, 1)


def log_above(values: np.ndarray, floor: np.float32) -> np.ndarray:
    """log(values + floor), values below 0 taken as 0."""
    found = np.maximum(values, np.float32(0))
    found += floor
    return np.log(found, out=found)


class ColorSolver:
    """Base colour maps for one shading of the observed pixels, from `begin` (t, t, 3)."""

    def __init__(self, pixels: MapPixels, shading: Shading, begin: np.ndarray, even: bool):
        """even: whether all pixels of a metal count the same, or by the log as others do."""
        self.pixels = pixels
        self.shading = shading
        self.begin = begin
        self.even = even

    def under(self, factor: float) -> ColorSolver:
        """The same under a light brighter by a factor."""
        if factor == 1:
            return self
        return ColorSolver(self.pixels, self.shading.under(factor), self.begin, self.even)

    @cached_property
    def otherwise(self) -> ColorSolver:
        """The same that counts metal the other way; what either has solved is kept."""
        return ColorSolver(self.pixels, self.shading, self.begin, not self.even)

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
    def judges(self) -> np.ndarray | None:
        """Which pixels (n,) are of every EVERY-th view; None where those are all views or none."""
        judge = self.pixels.observations.view % EVERY == 0
        return None if judge.all() or not judge.any() else judge

    @cached_property
    def by_other_views(self) -> tuple[np.ndarray, np.ndarray]:
        """`robust` colours and weights without the pixels that judge."""
        color, weight, _ = self.robust(self.judges)
        return color, weight
