"""Diffusion posterior sampling of the light with materials alongside, as published (DPI: Lyu et al.
2023).

Letters: x_t noisy code in DDPM scaling, ab = alpha_bar_t, x_0 its denoised estimate, L = s
decode(x_0) radiance with the light's scale s held, k materials, y photos, R the renderer. One step
from level t to s < t:

    roll     turn the light by a random number of columns                             (Eq. 19)
    x_0      = D(x_t / sqrt(ab); sigma_t)                                              (Eq. 7)
    g        = gradient in x_t of || y - R(L(x_0), k) ||, through renderer and network   (Eq. 13)
    x_s      = DDPM posterior sample given x_0 and x_t, minus rho_t g
    k        = one Adam step on || y - R(L(x_0), k) ||^2 with x_0 held                   (Eq. 16)

The base colour starts at 0, roughness and metallic at the fit's values; every sample has a copy of
its own and random numbers of its own. As in DPS (Chung et al. 2023) the gradient is that of the
un-squared norm, so that rho does not depend on the number of pixels; `guidance` multiplies rho, and
a sub-sequence of the T levels takes steps longer by T / n.
"""

from __future__ import annotations

import numpy as np
import torch

from pipeline.base.config import Sample
from pipeline.base.progress import Bar
from pipeline.posterior.problem import Materials, Problem, generators, guided_result, step_seed
from pipeline.prior.schedule import ALPHA_BAR, T, posterior, sigma, subsequence
from pipeline.prior.value_code import scale_of
from pipeline.render.envmap import yaw_roll
from pipeline.render.renderer import Explanation, resize_explanation

RHO_BASE = (
    30.0 / 2048
    # calibrates rho to the relative data term (problem.py) and codes of standard deviation 0.5; per
    # light pixel,
)
# because a finer grid divides the same gradient among more pixels
STEP_LIMIT = (
    0.5  # largest guidance step in units of the code's standard deviation, root mean square
)
PIXEL_LIMIT = 0.5  # largest guidance step of one pixel, a deviation of the codes


def rho(t: int) -> float:
    """The paper's weight: 0.1 above t = 500, rising linearly to 1 at t = 0."""
    return 0.1 if t > T // 2 else 0.1 + 0.9 * (T // 2 - t) / (T // 2)


def dpi_paper(
    problem: Problem, prior, start: Explanation, settings: Sample, seed: int
) -> tuple[Explanation, dict]:
    """One posterior sample. `start`: the fit. Returns the explanation at `settings.texture` and
    facts.

    Deterministic in `seed`: independent of other samples and of what ran before in the process.
    """
    rng, noise = generators(settings, seed)
    scale = scale_of(start.light)
    first = resize_explanation(start, settings.texture)
    first.base_color = np.zeros_like(first.base_color)
    materials = Materials(first, settings.learning_rate, problem.roughness_min)
    x = torch.randn((1, 3, prior.height, prior.width), generator=noise)
    levels, light, losses = subsequence(settings.steps), None, []
    with Bar(f"sample {seed}", len(levels)) as bar:
        for t, s in zip(levels, list(levels[1:]) + [-1]):
            columns = int(rng.integers(prior.width))
            x = x.roll(columns, -1).requires_grad_(True)  # Eq. 19
            x0 = prior.denoise(x / np.sqrt(ALPHA_BAR[t]), sigma(t), settings.label)  # Eq. 7
            radiance = scale * prior.decode(x0)[0]
            turned = radiance.detach().numpy().transpose(1, 2, 0)
            light = np.ascontiguousarray(yaw_roll(turned, -columns))
            now = materials.explanation(light)
            g = problem.gradient(
                now, problem.batch(settings.pixels, settings.spp, rng), step_seed(rng)
            )
            slope = torch.from_numpy(
                np.ascontiguousarray(yaw_roll(g.light, columns).transpose(2, 0, 1))
            )
            (pull,) = torch.autograd.grad((radiance * slope).sum(), x)  # Eq. 13
            weight = (
                RHO_BASE
                * prior.height
                * prior.width
                * settings.guidance
                * rho(t)
                * (T / len(levels))
            )
            move = weight * pull / (2 * np.sqrt(max(g.loss, 1e-6)))
            size = float(move.square().mean().sqrt())
            move = move * min(1.0, STEP_LIMIT * 0.5 / max(size, 1e-12))
            move = move.clamp(
                -PIXEL_LIMIT, PIXEL_LIMIT
            )  # a path that met the sun must not send one pixel to the code's end
            a, b, deviation = posterior(int(t), int(s))
            with torch.no_grad():
                fresh = torch.randn(x.shape, generator=noise) if s >= 0 else torch.zeros_like(x)
                x = (a * x0 + b * x + deviation * fresh - move).roll(-columns, -1)
            materials.step(g)  # Eq. 16
            losses.append(g.loss)
            bar.step(f"loss {g.loss:.4f}")
    # median: with few paths per pixel, one that meets the sun makes a step's loss a hundred times
    # what it is
    tail = losses[-max(1, len(losses) // 10) :]
    return guided_result(prior, x, scale, materials, losses[0], float(np.median(tail)))
