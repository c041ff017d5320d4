"""Scores: how well an explanation predicts photos it has not seen, and how meshes and lights
compare with truth.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Protocol

import cv2
import flip_evaluator
import numpy as np

from pipeline.base.images import linear_to_srgb, read_exr, read_png
from pipeline.geometry.cameras import View
from pipeline.render.envmap import solid_angles
from pipeline.render.observe import Observations, inner_mask
from pipeline.render.renderer import Explanation, JitteredRays, Renderer

SCORED_SIDE = 640  # longest side in pixels at which held-out photos are compared
FEWEST_SCORED = (
    16  # pixels of a held-out view, or all that it has: fewer have no spread to speak of
)


class PhotosAndRenderer(Protocol):
    """What scores need of a problem (pipeline.posterior.problem, a later layer)."""

    observations: Observations
    renderer: Renderer


def flip_map(picture: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """FLIP (h, w) in [0, 1] of two pictures (h, w, 3) of sRGB values in [0, 1]: how far they differ
    to an eye to which they alternate, at 67 pixels a degree (Andersson et al. 2020, the authors'
    code). 0 is the same.
    """
    pair = (np.ascontiguousarray(one, np.float32) for one in (truth, picture))
    error, _, _ = flip_evaluator.evaluate(*pair, "LDR", applyMagma=False)
    return error[..., 0]


def crossed_error(
    picture: np.ndarray, truth: np.ndarray, again: np.ndarray, truth_again: np.ndarray | None = None
) -> np.ndarray:
    """Squared error (h, w, 3) as sRGB values in [0, 1] of a picture that was rendered twice: the
    product of both errors, in which the noise of each drops out of the mean. truth_again: where
    the truth is a render, the same with noise of its own, which drops out too.
    """
    target = linear_to_srgb(truth)
    other = target if truth_again is None else linear_to_srgb(truth_again)
    return (linear_to_srgb(picture) - target) * (linear_to_srgb(again) - other)


def psnr(
    picture: np.ndarray,
    truth: np.ndarray,
    mask: np.ndarray | None = None,
    again: np.ndarray | None = None,
    truth_again: np.ndarray | None = None,
) -> float:
    """Peak signal-to-noise ratio in dB of two linear pictures, compared as sRGB values in [0, 1],
    inside `mask`.

    again: what `picture` shows, rendered once more with noise of its own. The two errors are
    multiplied then, so that the path tracer's noise drops out: at 64 paths a pixel its square would
    be a fifth of all error, and more where the light is peaked. truth_again: as `crossed_error`
    has it. The score ends at 100 dB, where what is left is noise.
    """
    error = crossed_error(picture, truth, picture if again is None else again, truth_again)
    if mask is not None:
        error = error[mask]
    return float(-10 * np.log10(max(error.mean(), 1e-10)))


def view_rays(view: View, pixels: np.ndarray) -> JitteredRays:
    """rays(rng) -> origins, directions (n, 3): one random point in each of `pixels` (n, 2), columns
    and rows.
    """

    def rays(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        origins, directions = view.rays(pixels + rng.random(pixels.shape))
        return np.ascontiguousarray(origins, np.float32), directions.astype(np.float32)

    return rays


def render_pixels(
    renderer: Renderer,
    explanation: Explanation,
    view: View,
    mask: np.ndarray,
    spp: int,
    seed: int = 0,
) -> np.ndarray:
    """Picture (h, w, 3) of the object on black, of which only the pixels of `mask` (h, w) are
    traced; the others are black.
    """
    rows, columns = np.nonzero(mask)
    rays = view_rays(view, np.stack([columns, rows], -1))

    renderer.set(explanation)
    picture = np.zeros(mask.shape + (3,), np.float32)
    picture[rows, columns] = renderer.mean_radiance(rays, spp, seed)
    return picture


def render_twice(
    renderer: Renderer, explanation: Explanation, view: View, mask: np.ndarray, spp: int
) -> np.ndarray:
    """Two independent pictures (2, h, w, 3) of `render_pixels`, each of half the `spp` paths, for
    `psnr`.
    """
    half = spp // 2
    return np.stack(
        [render_pixels(renderer, explanation, view, mask, half, seed) for seed in (0, 1)]
    )


def held_out_photos(
    problem: PhotosAndRenderer, poses: Path, mesh: Path, erode: float, limit: int = 8
) -> list[tuple[View, np.ndarray, np.ndarray]]:
    """Held-out views (at most `limit`) at the size they are scored, each with its photo (h, w, 3)
    and its mask (h, w) less a rim of `erode` mixed pixels; views of which nothing is left are
    passed over. Photos are at the observations' exposure.
    """
    held_out = problem.observations.held_out
    spacing = max(1, len(held_out) // limit)
    found = []

    for view in held_out[::spacing][:limit]:
        small = view.scaled(min(1.0, SCORED_SIDE / max(view.width, view.height)))
        size = (small.width, small.height)

        photo = cv2.resize(read_exr(poses / view.image), size, interpolation=cv2.INTER_AREA)
        photo = photo / 2 ** problem.observations.stops[view.name].astype(np.float32)
        inner = inner_mask(read_png(mesh / "masks" / f"{view.name}.png") > 127, erode)
        covered = cv2.resize(inner.astype(np.float32), size, interpolation=cv2.INTER_AREA)
        mask = covered > 0.999  # pixels that lie wholly inside

        if mask.any():
            found.append((small, photo, mask))
    return found


def some_of(mask: np.ndarray, share: float, rng: np.random.Generator) -> np.ndarray:
    """A `share` of the pixels of `mask` (h, w), at least FEWEST_SCORED or all: one at random of so
    many that follow each other in rows.

    Stratified sampling (Cochran 1977, chapter 5): neighbours err alike, so that it tells more than
    as many pixels at random.
    """
    inside = np.flatnonzero(mask)
    count = min(max(round(share * len(inside)), FEWEST_SCORED), len(inside))
    edges = np.linspace(0, len(inside), count + 1).round().astype(int)
    chosen = np.zeros(mask.size, bool)
    chosen[inside[rng.integers(edges[:-1], edges[1:])]] = True
    return chosen.reshape(mask.shape)


def scored_pixels(
    held_out: list[tuple[View, np.ndarray, np.ndarray]], pixels: int
) -> list[np.ndarray]:
    """Which pixels (h, w) of each held-out view count in a score, `pixels` of all views together:
    the same for every sample, and for what it is compared with.
    """
    total = sum(int(mask.sum()) for _, _, mask in held_out)
    rng = np.random.default_rng(0)
    return [some_of(mask, pixels / total, rng) for _, _, mask in held_out]


def standard_error(error: np.ndarray, of: int) -> float:
    """Standard error in dB of the PSNR from squared errors (k, 3) of k random pixels out of `of`;
    of `some_of` an upper bound, where neighbours err alike.

    The mean's relative standard error, with the finite population's correction (Cochran 1977,
    Sampling Techniques, eq. 2.9), times 10 / log 10. All pixels of a view have none. Raises
    ValueError for one pixel out of several, whose spread nobody knows.
    """
    per_pixel = error.mean(1)
    count = len(per_pixel)
    if count == of:
        return 0.0
    if count < 2:
        raise ValueError(f"{count} pixel out of {of} has no standard error")
    variance = per_pixel.var(ddof=1) / count * (1 - count / of)
    return float(10 / np.log(10) * np.sqrt(max(variance, 0)) / max(per_pixel.mean(), 1e-10))


def score_held_out(
    problem: PhotosAndRenderer,
    explanation: Explanation,
    held_out: list[tuple[View, np.ndarray, np.ndarray]],
    pixels: int,
    spp: int,
    step: Callable[[], object] = lambda: None,
) -> dict:
    """PSNR of `explanation` on each of `held_out` (`held_out_photos`) and their mean (None without
    any), from `pixels` of all of them together (`scored_pixels`), a number that is said too; with
    the standard error in dB that comes from not taking them all. `step()` is called after each
    view.
    """
    scores = {}
    errors = []

    for (view, photo, mask), chosen in zip(held_out, scored_pixels(held_out, pixels)):
        picture, again = render_twice(problem.renderer, explanation, view, chosen, spp)
        scores[view.name] = psnr(picture, photo, chosen, again)
        errors.append(standard_error(crossed_error(picture, photo, again)[chosen], int(mask.sum())))
        step()

    count = len(scores)
    return {
        "held_out_psnr": float(np.mean(list(scores.values()))) if scores else None,
        "held_out_standard_error": float(np.linalg.norm(errors) / count) if scores else None,
        "held_out": scores,
        "held_out_pixels": pixels,
    }


def light_psnr(light: np.ndarray, truth: np.ndarray, rows: int | None = None) -> float:
    """PSNR in dB of two lat-long lights as log radiance over a range of e^6, after one common
    scale; solid-angle weighted. rows: of the uppermost rows only.
    """
    floored_log = lambda env: np.log(np.maximum(env, 1e-3 * env.mean()))
    log_light = floored_log(light)[:rows]
    log_truth = floored_log(truth)[:rows]
    weight = solid_angles(*light.shape[:2])[:rows, :, None]
    weight = weight / weight.sum() / 3

    shift = ((log_light - log_truth) * weight).sum()
    error = (((log_light - log_truth - shift) / 6) ** 2 * weight).sum()
    return float(-10 * np.log10(max(error, 1e-10)))
