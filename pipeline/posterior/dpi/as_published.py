"""`dpi_paper`: diffusion posterior sampling of the light with materials alongside, as published
(DPI, Lyu et al. 2023).

Letters: x_t noisy code at noise level t of T in DDPM scaling, ab_t = alpha_bar_t, x_0 its denoised
estimate, k materials, y photos, R the renderer. s < t is the next level, -1 the noise-free end. The
equations name the light by its code; the renderer is given the radiance that it stands for, times
the light's scale, which is held.

One turn of the loop, from level t to s, has five steps:

    roll             turn the light by a random number of columns            Eq. 19
    denoised         x_0, the network's estimate of the clean code           Eq. 7
    reverse_step     x_s drawn given x_0 and x_t, as the prior alone has it
    guidance         what is taken off x_s, for the photos' sake             Eq. 13
    material_step    one step of Adam on k, with x_0 held                    Eq. 16
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import torch

from pipeline.base.config import Sample
from pipeline.base.progress import Bar
from pipeline.posterior.dpi.light_of_code import (
    as_light,
    decoded,
    finished_sample,
    slope_in_code,
)
from pipeline.posterior.material_optimizer import MaterialOptimizer
from pipeline.posterior.problem import Problem, renderer_seed
from pipeline.posterior.random_numbers import generators
from pipeline.prior.protocol import Prior
from pipeline.prior.schedule import ALPHA_BAR, T, posterior, sigma, subsequence
from pipeline.prior.value_code import scale_of
from pipeline.render.renderer import Explanation, Gradient, resize_explanation

# Calibrates rho to the relative data term (problem.py) and to codes of standard deviation 0.5. Per
# light pixel, because a finer grid divides the same gradient among more pixels.
RHO_BASE = 30.0 / 2048
CODE_DEVIATION = 0.5  # standard deviation of the prior's codes (prior/value_code.py)
STEP_LIMIT = 0.5 * CODE_DEVIATION  # largest guidance step, root mean square over the pixels
# Largest guidance step of one pixel: a path that met the sun must not send one pixel to the end of
# the codes' range.
PIXEL_LIMIT = CODE_DEVIATION


def level_pairs(steps: int) -> list[tuple[int, int]]:
    """(t, s) of every turn: `steps` of the T levels, descending, and after the last the noise-free
    end -1.
    """
    levels = [int(t) for t in subsequence(steps)]
    return list(zip(levels, levels[1:] + [-1]))


def roll(code: torch.Tensor, columns: int) -> torch.Tensor:
    """The code (1, 3, h, w) turned about the vertical by `columns`.

    Eq. 19 (published): x_t <- roll(x_t, c) before the network and roll(x_s, -c) after it, with c
    random in 0..w-1 at every level, so that the network's borders, which do not join left to right,
    leave no seam at a fixed place.

    Ours: the same.
    """
    return code.roll(columns, -1)


def denoised(prior: Prior, noisy: torch.Tensor, t: int, label: str | None) -> torch.Tensor:
    """x_0 (1, 3, h, w) of x_t.

    Eq. 7 (published): x_0 = (x_t - sqrt(1 - ab_t) eps(x_t, t)) / sqrt(ab_t)

    with eps the noise that the network finds in x_t.

    Ours: x_0 = D(x_t / sqrt(ab_t); sigma_t) with sigma_t = sqrt((1 - ab_t) / ab_t)

    the same estimate from a network D that returns the clean code itself (prior/schedule.py). D may
    be told the scene's class, `label`.
    """
    return prior.denoise(noisy / np.sqrt(ALPHA_BAR[t]), sigma(t), label)


def reverse_step(
    clean: torch.Tensor, noisy: torch.Tensor, t: int, s: int, noise: torch.Generator
) -> torch.Tensor:
    """x_s ~ q(x_s | x_t, x_0), DDPM's step without guidance; at s = -1 without fresh noise."""
    of_clean, of_noisy, deviation = posterior(t, s)
    fresh = torch.randn(noisy.shape, generator=noise) if s >= 0 else torch.zeros_like(noisy)
    return of_clean * clean + of_noisy * noisy + deviation * fresh


def rho(t: int) -> float:
    """The paper's weight of the guidance: 0.1 above t = 500, rising linearly to 1 at t = 0."""
    return 0.1 if t > T // 2 else 0.1 + 0.9 * (T // 2 - t) / (T // 2)


def guidance_weight(t: int, prior: Prior, settings: Sample) -> float:
    """rho_t in our units, times the setting `guidance`, and times T / n where n of the T levels are
    visited: steps are longer by that much.
    """
    longer = T / settings.steps
    return RHO_BASE * prior.height * prior.width * settings.guidance * rho(t) * longer


def guidance(slope: torch.Tensor, loss: float, weight: float) -> torch.Tensor:
    """What is taken off x_s (1, 3, h, w).

    Eq. 13 (published): x_s = (DDPM's step from x_t and x_0) - rho_t grad_{x_t} || y - R(x_0, k) ||

    with the gradient taken through the renderer and, as x_0 = x_0(x_t), through the network.

    Ours: the norm is the root of problem.py's loss, a mean relative error, so that rho does not
    depend on the number of pixels. It is un-squared as in DPS (Chung et al. 2023). `slope` is
    grad_{x_t} of that `loss`; its root's gradient is slope / (2 sqrt(loss)). `weight` stands for
    rho_t (`guidance_weight`). Steps are limited by STEP_LIMIT and PIXEL_LIMIT.
    """
    move = weight * slope / (2 * np.sqrt(max(loss, 1e-6)))
    size = float(move.square().mean().sqrt())
    move = move * min(1.0, STEP_LIMIT / max(size, 1e-12))
    return move.clamp(-PIXEL_LIMIT, PIXEL_LIMIT)


def material_step(materials: MaterialOptimizer, gradient: Gradient) -> None:
    """Moves `materials` in place.

    Eq. 16 (published): k <- k - step of Adam along grad_k || y - R(x_0, k) ||^2, with x_0 held,
    once per level

    Ours: the loss is the mean relative error of problem.py, and the gradient comes from the same
    paths as the guidance's; roughness and metallic move as smooth fields, and all maps stay in
    their valid ranges (material_optimizer.py).
    """
    materials.step(gradient)


@dataclass(frozen=True)
class Turn:
    """What a turn leaves: clean, x_0 (1, 3, h, w), what the light is taken for at its level; code,
    x_s (1, 3, h, w); and the loss under x_0.
    """

    clean: torch.Tensor
    code: torch.Tensor
    loss: float


def begun(problem: Problem, fit: Explanation, settings: Sample) -> tuple[float, MaterialOptimizer]:
    """The light's scale, and materials that begin at the fit's roughness and metallic, at a base
    colour of 0.
    """
    first = resize_explanation(fit, settings.texture)
    first = replace(first, base_color=np.zeros_like(first.base_color))
    materials = MaterialOptimizer(first, settings.learning_rate, problem.roughness_min)
    return scale_of(fit.light), materials


def turns(
    problem: Problem,
    prior: Prior,
    light_scale: float,
    materials: MaterialOptimizer,
    settings: Sample,
    seed: int,
) -> Iterator[Turn]:
    """The loop, from noise to the light of one sample; moves `materials` in place."""
    rng, noise = generators(seed)
    code = torch.randn((1, 3, prior.height, prior.width), generator=noise)
    for t, s in level_pairs(settings.steps):
        columns = int(rng.integers(prior.width))
        noisy = roll(code, columns).requires_grad_(True)  # Eq. 19
        clean = denoised(prior, noisy, t, settings.label)  # Eq. 7
        radiance = decoded(prior, clean, light_scale)

        explanation = materials.explanation(as_light(radiance, columns))
        batch = problem.batch(settings.pixels, settings.spp, rng)
        gradient = problem.gradient(explanation, batch, renderer_seed(rng))

        slope = slope_in_code(radiance, gradient.light, noisy, columns)
        move = guidance(slope, gradient.loss, guidance_weight(t, prior, settings))  # Eq. 13
        with torch.no_grad():
            code = roll(reverse_step(clean, noisy, t, s, noise) - move, -columns)
        material_step(materials, gradient)  # Eq. 16
        yield Turn(roll(clean.detach(), -columns), code, gradient.loss)


def dpi_paper(
    problem: Problem, prior: Prior, start: Explanation, settings: Sample, seed: int
) -> tuple[Explanation, dict]:
    """One posterior sample at `settings.texture`, and facts. `start`: the fit.

    Deterministic in `seed`: independent of other samples and of what ran before in the process.
    """
    light_scale, materials = begun(problem, start, settings)
    losses = []
    with Bar(f"sample {seed}", settings.steps) as bar:
        for turn in turns(problem, prior, light_scale, materials, settings, seed):
            losses.append(turn.loss)
            bar.step(f"loss {turn.loss:.4f}")

    sample = finished_sample(prior, turn.code, light_scale, materials)
    return sample, {"scale": light_scale, "loss_first": losses[0], "loss_last": end_of(losses)}


def end_of(losses: list[float]) -> float:
    """Median loss of the last tenth of the steps: with few paths per pixel, one that meets the sun
    makes a step's loss a hundred times what it is.
    """
    return float(np.median(losses[-max(1, len(losses) // 10) :]))
