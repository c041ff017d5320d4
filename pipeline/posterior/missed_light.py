"""What light a surface gets in details that are finer than the cells of interpolated shading.

shading.py traces some pixels and interpolates between them, so that D is smooth within a cell of a
photo. The base colour of a crevice finer than that is then taken for darker than it is, and the
finished asset, path traced, is darker still: in the photos that garden was made from it renders
.27 dB worse than the solve says. Sharing D between photos does not help, for all of them miss the
same detail.

So single paths are traced through all pixels that show no metal. One says little, but those of a
texel's pixels together say by how much a D + S is off there. With L what a path brings, the texel's
D rises by

    E = sum w (L - a D - S) / sum w a,    w = (a D / (a D + S))^2

times the pixel's own weight: where most of the light is a highlight, what that is wrong by is not
taken for light on the surface. E is shrunk to that of the texels around it, coarse to fine, where
paths are few (base_color.py). A metal's D moves with the view and is left as it is.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from pipeline.posterior.map_pixels import MapPixels
from pipeline.posterior.map_pyramid import TexelSums, coarse_to_fine
from pipeline.posterior.problem import Problem, renderer_seed
from pipeline.posterior.shading import LEAST, Shading
from pipeline.posterior.textures import closed_gaps
from pipeline.render.renderer import Explanation

# paths that a texel's surroundings count as, at every level: one path's error is about as large
# as D, and what the cells miss a fifteenth of that
AROUND = 256.0
METAL = 0.95  # metallic from which on there is next to no D that paths could put right
CHUNK = 1 << 19  # pixels at a time


def unmetallic_pixels(shading: Shading) -> np.ndarray:
    """The observed pixels that show anything but metal."""
    return np.flatnonzero(shading.metallic[:, 0] < METAL)


def paths_for(pixels: MapPixels, some: np.ndarray, texel_paths: float) -> int:
    """How many paths are `texel_paths` for every texel that the pixels `some` (numbers) show, or
    for every one of them where they are fewer.
    """
    chosen = np.zeros_like(pixels.cosine)
    chosen[some] = 1
    texels = int(closed_gaps(pixels.onto(chosen)[..., 0]).sum())
    return round(texel_paths * min(texels, len(some)))


def single_paths(
    problem: Problem,
    explanation: Explanation,
    pixels: np.ndarray,
    paths: int,
    rng: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray]:
    """Sums (n, 3) of the radiance of `paths` paths over `pixels` of the n observed ones, and how
    many there are through each (n, 1): as many through one as through another, and one more through
    some.
    """
    observations, renderer = problem.observations, problem.renderer
    renderer.set(explanation)
    total = np.zeros((len(observations), 3), np.float32)
    made = np.zeros((len(observations), 1), np.float32)

    def trace(some: np.ndarray, spp: int) -> None:
        for index in in_chunks(some):
            rays = partial(observations.rays, index)
            total[index] += spp * renderer.mean_radiance(rays, spp, renderer_seed(rng))
            made[index] += spp

    each, more = divmod(paths, len(pixels))
    if each:
        trace(pixels, each)
    trace(pixels[np.sort(rng.choice(len(pixels), more, replace=False))], 1)
    return total, made


def in_chunks(index: np.ndarray) -> list[np.ndarray]:
    """The numbers, CHUNK at a time: rays of all pixels at once would take gigabytes."""
    return [index[i : i + CHUNK] for i in range(0, len(index), CHUNK)]


def with_missed_light(
    problem: Problem,
    pixels: MapPixels,
    explanation: Explanation,
    shading: Shading,
    texel_paths: float,
    rng: np.random.Generator,
) -> Shading:
    """`shading` of the explanation, with what paths through single pixels, `texel_paths` for every
    texel, show beyond it added to D where the surface is no metal. Its base colour must not be zero
    anywhere. pixels: the problem's, on maps of the base colour's size.
    """
    some = unmetallic_pixels(shading)
    paths = paths_for(pixels, some, texel_paths)
    if not paths:
        return shading
    color = pixels.of(explanation.base_color)
    dielectric = 1 - shading.metallic
    radiance, made = single_paths(problem, explanation, some, paths, rng)
    diffuse = color * shading.scaled
    missed = radiance - made * (diffuse + shading.rest)

    share = diffuse / np.maximum(diffuse + shading.rest, diffuse)
    weight = pixels.cosine * dielectric * share**2
    sums = TexelSums(
        pixels.onto(weight * missed), pixels.onto(weight * made * color), pixels.onto(made)
    )
    more = pixels.of(coarse_to_fine(sums, AROUND))
    scaled = np.maximum(shading.scaled + dielectric * more, LEAST)
    return replace(shading, scaled=scaled.astype(np.float32))
