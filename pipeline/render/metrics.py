"""Scores: how well an explanation predicts photos it has not seen, and how meshes and lights
compare with truth.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from pipeline.base.images import linear_to_srgb, read_exr, read_png
from pipeline.geometry.cameras import View
from pipeline.render.envmap import solid_angles
from pipeline.render.observe import inner_mask
from pipeline.render.renderer import Explanation, Renderer


def psnr(
    a: np.ndarray, b: np.ndarray, mask: np.ndarray | None = None, again: np.ndarray | None = None
) -> float:
    """Peak signal-to-noise ratio in dB of two linear pictures, compared as sRGB values in [0, 1],
    inside `mask`.

    again: what `a` shows, rendered once more with noise of its own. The two errors are multiplied
    then, so that the path tracer's noise drops out: at 64 paths a pixel its square would be a fifth
    of all error, and more where the light is peaked.
    """
    target = linear_to_srgb(b)
    error = (linear_to_srgb(a) - target) * (linear_to_srgb(a if again is None else again) - target)
    error = error[mask] if mask is not None else error
    return float(-10 * np.log10(max(error.mean(), 1e-10)))


def view_rays(view: View, pixels: np.ndarray):
    """rays(rng) -> o, d (n, 3): one random point in each of `pixels` (n, 2), columns and rows."""

    def rays(rng):
        o, d = view.rays(pixels + rng.random(pixels.shape))
        return np.ascontiguousarray(o, np.float32), d.astype(np.float32)

    return rays


def render_view(
    renderer: Renderer, x: Explanation, view: View, spp: int, seed: int = 0
) -> np.ndarray:
    """Picture (h, w, 3) of the object on black."""
    return render_pixels(renderer, x, view, np.ones((view.height, view.width), bool), spp, seed)


def render_pixels(
    renderer: Renderer, x: Explanation, view: View, mask: np.ndarray, spp: int, seed: int = 0
) -> np.ndarray:
    """As `render_view`, tracing only the pixels of `mask` (h, w); the others are black."""
    rows, columns = np.nonzero(mask)
    out = np.zeros(mask.shape + (3,), np.float32)
    renderer.set(x)
    out[rows, columns] = renderer.mean_radiance(
        view_rays(view, np.stack([columns, rows], -1)), spp, seed
    )
    return out


def render_twice(
    renderer: Renderer, x: Explanation, view: View, mask: np.ndarray, spp: int
) -> np.ndarray:
    """Two independent pictures (2, h, w, 3) of `render_pixels`, each of half the `spp` paths, for
    `psnr`.
    """
    return np.stack([render_pixels(renderer, x, view, mask, spp // 2, seed) for seed in (0, 1)])


def held_out_photos(
    problem, poses: Path, mesh: Path, erode: float, limit: int = 8
) -> list[tuple[View, np.ndarray, np.ndarray]]:
    """Held-out views (at most `limit`) at the size they are scored, each with its photo (h, w, 3)
    and its mask (h, w) less a rim of `erode` mixed pixels; views of which nothing is left are
    passed over.
    """
    out, held = [], problem.observations.held_out
    for view in held[:: max(1, len(held) // limit)][:limit]:
        small = view.scaled(min(1.0, 640 / max(view.width, view.height)))
        size = (small.width, small.height)
        photo = cv2.resize(read_exr(poses / view.image), size, interpolation=cv2.INTER_AREA)
        inner = inner_mask(read_png(mesh / "masks" / f"{view.name}.png") > 127, erode)
        mask = cv2.resize(inner.astype(np.float32), size, interpolation=cv2.INTER_AREA) > 0.999
        if mask.any():
            out.append((small, photo, mask))
    return out


def score_held_out(
    problem, x: Explanation, poses: Path, mesh: Path, erode: float, spp: int
) -> dict:
    """PSNR of `x` on each of `held_out_photos`, and their mean."""
    scores = {}
    for view, photo, mask in held_out_photos(problem, poses, mesh, erode):
        picture, again = render_twice(problem.renderer, x, view, mask, spp)
        scores[view.name] = psnr(picture, photo, mask, again)
    return {
        "held_out_psnr": float(np.mean(list(scores.values()))) if scores else None,
        "held_out": scores,
    }


def light_psnr(a: np.ndarray, b: np.ndarray) -> float:
    """PSNR in dB of two lat-long lights as log radiance over a range of e^6, after one common
    scale; solid-angle weighted.
    """
    la, lb = np.log(np.maximum(a, 1e-3 * a.mean())), np.log(np.maximum(b, 1e-3 * b.mean()))
    weight = (solid_angles(*a.shape[:2]) / (4 * np.pi))[..., None] / 3
    shift = ((la - lb) * weight).sum()
    return float(-10 * np.log10((((la - lb - shift) / 6) ** 2 * weight).sum()))
