"""Materials at full texture size with the light's shape held, and one light scale (DPI, Eq. 17).

Three blocks in turn. Roughness and metallic: Adam through the path tracer, on maps of moderate size, because photos say
little about their fine detail. Light scale: a closed-form factor. Base colour at full size: per texel the least-squares
factor f that makes the photos right. With G the derivative of the picture along the base colour (G = a dL/da; the
picture is nearly linear in it), f = 1 + sum w G (y - L) / sum w G^2 over the pixels that see the texel; two independent
halves of the paths keep noise in G from biasing it. Texels that few pixels see stay near their smoother surroundings.
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from scipy import ndimage

from ..config import Refine
from ..optics import Explanation, resize_explanation
from ..progress import Bar
from .problem import ALBEDO_MAX, SHADE, Materials, Problem, step_seed

COARSE = 256        # side of the roughness and metallic maps during the steps
TRUST = 0.05        # sum of weighted G^2 at which a texel's own evidence weighs as much as its surroundings'
FACTOR = (0.25, 4.0)


def render_pairs(problem: Problem, x: Explanation, index: np.ndarray, spp: int, rng) -> tuple[np.ndarray, np.ndarray]:
    """L (2, n, 3) and G (2, n, 3) of the pixels `index`: two independent estimates each, `spp` paths in all."""
    half = replace(x, base_color=0.5 * x.base_color)
    rays = [problem.observations.rays(index, rng) for _ in range(spp)]
    seeds = [step_seed(rng) for _ in range(spp)]
    pictures = []
    for maps in (x, half):                                    # same rays and seeds: their difference has little noise
        problem.renderer.set(maps)
        paths = [problem.renderer.radiance(o, d, s) for (o, d), s in zip(rays, seeds)]
        pictures.append(np.stack([np.mean(paths[:spp // 2], 0), np.mean(paths[spp // 2:], 0)]))
    return pictures[0], 2 * (pictures[0] - pictures[1])


def splat(uv: np.ndarray, values: np.ndarray, size: int) -> np.ndarray:
    """Add values (n, c) bilinearly into a (size, size, c) texture, row 0 is v = 1."""
    x, y = uv[:, 0] * size - 0.5, (1 - uv[:, 1]) * size - 0.5
    out = np.zeros((size * size, values.shape[1]))
    for dx in (0, 1):
        for dy in (0, 1):
            i, j = np.floor(x).astype(int) + dx, np.floor(y).astype(int) + dy
            weight = (1 - np.abs(x - i)) * (1 - np.abs(y - j))
            flat = np.clip(j, 0, size - 1) * size + np.clip(i, 0, size - 1)
            for c in range(values.shape[1]):
                out[:, c] += np.bincount(flat, weight * values[:, c], size * size)
    return out.reshape(size, size, -1)


def smoothed(total: np.ndarray, sigma: float) -> np.ndarray:
    return cv2.GaussianBlur(total, (0, 0), sigma, borderType=cv2.BORDER_REPLICATE)


def fill(image: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Nearest known texel's value for unknown ones: chart borders and parts that no photo shows."""
    if not known.any():
        return image
    nearest = ndimage.distance_transform_edt(~known, return_distances=False, return_indices=True)
    return image[tuple(nearest)]


def base_color_block(problem: Problem, x: Explanation, spp: int, chunk: int, rng) -> tuple[Explanation, float]:
    """One least-squares update of the whole base colour map; also the loss before it."""
    obs, size = problem.observations, x.base_color.shape[0]
    top, bottom, loss, floor = np.zeros((size, size, 3)), np.zeros((size, size, 3)), 0.0, 1e-3
    x = replace(x, base_color=np.maximum(x.base_color, 0.02))        # a black texel has no direction to move along
    order = np.arange(len(obs))
    for k in range(0, len(obs), chunk):
        index = order[k:k + chunk]
        L, G = render_pairs(problem, x, index, spp, rng)
        y = obs.rgb[index]
        r = y - L
        r = np.where(obs.clipped[index][None, :, None] & (r < 0), 0, r)
        weight = 1 / (y + SHADE) ** 2
        top += splat(obs.uv[index], weight * 0.5 * (G[0] * r[1] + G[1] * r[0]), size)
        bottom += splat(obs.uv[index], weight * np.maximum(G[0] * G[1], floor * G.mean(0) ** 2), size)
        loss += float((weight * r[0] * r[1]).sum())
    spread = max(1.0, size / 256)
    around = smoothed(top, 2 * spread) / (smoothed(bottom, 2 * spread) + 1e-6)
    factor = 1 + (top + TRUST * around) / (bottom + TRUST)
    known = bottom.max(-1) > 1e-3
    color = np.clip(x.base_color * np.clip(factor, *FACTOR), 0.0, ALBEDO_MAX)
    return replace(x, base_color=fill(color, known).astype(np.float32)), loss / (3 * len(obs))


def light_scale(problem: Problem, x: Explanation, pixels: int, rng) -> float:
    """Least-squares factor of the light: sum w L y / sum w L L over random unsaturated pixels."""
    obs = problem.observations
    index = rng.integers(len(obs), size=pixels)
    index = index[~obs.clipped[index]] if (~obs.clipped[index]).any() else index
    L, _ = render_pairs(problem, x, index, 4, rng)
    weight = 1 / (obs.rgb[index] + SHADE) ** 2
    return float((weight * L.mean(0) * obs.rgb[index]).sum() / np.maximum((weight * L[0] * L[1]).sum(), 1e-9))


def refine(problem: Problem, small: Problem, x: Explanation, settings: Refine, seed: int) -> tuple[Explanation, dict]:
    """Run Eq. 17 from a sample `x`. `problem` renders at full texture size, `small` at COARSE. Returns maps and facts."""
    rng = np.random.default_rng([977, seed])
    coarse = resize_explanation(x, small.renderer.texture)
    scale = float(np.clip(light_scale(small, coarse, 8 * settings.pixels, rng), 0.5, 2.0))
    light = (x.light * scale).astype(np.float32)
    coarse, losses = replace(coarse, light=light), []
    coarse, before = base_color_block(small, coarse, 4, 1 << 18, rng)
    materials = Materials(coarse, settings.learning_rate, small.roughness_min)
    with Bar(f"refine {seed}", max(settings.steps, 1)) as bar:
        for k in range(settings.steps):
            materials.decay(settings.learning_rate * 0.1 ** (k / settings.steps))
            now = materials.explanation(light)
            g = small.gradient(now, small.batch(settings.pixels, settings.spp, rng), step_seed(rng))
            materials.step(g)
            losses.append(g.loss)
            bar.step(f"loss {np.mean(losses[-20:]):.4f}")
    full = resize_explanation(materials.explanation(light), settings.texture)
    for _ in range(2):
        full, last = base_color_block(problem, full, 4, 1 << 18, rng)
    known = splat(problem.observations.uv, np.ones((len(problem.observations), 1)), settings.texture)[..., 0] > 1e-3
    full = replace(full, roughness=fill(full.roughness, known), metallic=fill(full.metallic, known))
    return full, {"light_scale": scale, "loss_before": before, "loss_last_update": last, "seen_share_of_texels": float(known.mean())}
