"""What split_gibbs is compared with, on the same network and renderer: `dpi_code`, `sds`, `map`
(`dpi_paper`: dpi.py).

`dpi_code` is DPI as its authors released it, which differs from the paper (design note `method.md`,
section 3), without the four defects listed there: every sample starts from its own state, every
step has its own random numbers, the light stays floating point, and the wrap column is right.
Constants tied to the authors' [0, 1] value code are carried over by RANGE, the width of our codes
that theirs spans.
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

RANGE = 2.0  # four standard deviations of our codes
RATES = {"base_color": 0.02, "roughness": 0.015, "metallic": 0.01}
GAUGE_EVERY = 50  # steps after which base colour and roughness are divided by their largest value


def rho_code(t: int, outdoor: bool) -> float:
    """The released guidance weight over s = t / T."""
    s = t / T
    if s >= 0.9:
        return 0.01
    if not outdoor:
        return 0.1 if s >= 0.5 else 1.0
    return 0.1 + 0.9 * (0.9 - s) / 0.4 if s >= 0.5 else 0.2 + 0.8 * s / 0.5


def norm_loss(batch, indoor: bool):
    """Un-squared L2 norm, of log(1 + y) indoors; a saturated pixel is no error where it is
    exceeded.
    """

    def loss(L):
        value, slope = (np.log1p(L), 1 / (1 + L)) if indoor else (L, np.ones_like(L))
        r = value - (np.log1p(batch.y) if indoor else batch.y)
        r = np.where(batch.clipped[:, None] & (r > 0), 0, r)
        size = float(np.sqrt((r**2).sum()))
        return size, r * slope / max(size, 1e-9)

    return loss


def tame(gradient: torch.Tensor) -> torch.Tensor:
    """Divided by ten until no entry exceeds 0.1."""
    biggest = float(gradient.abs().max())
    return gradient / 10 ** max(0, int(np.ceil(np.log10(max(biggest, 1e-30) / 0.1))))


def dpi_code(
    problem: Problem, prior, start: Explanation, settings: Sample, seed: int
) -> tuple[Explanation, dict]:
    """One sample by the released algorithm; arguments as `dpi_paper`."""
    rng, noise = generators(settings, seed)
    outdoor, scale, views = (
        settings.label != "indoor",
        scale_of(start.light),
        len(problem.observations.views),
    )
    first = resize_explanation(start, settings.texture)
    first.base_color = np.full_like(first.base_color, 0.01)
    materials, losses = Materials(first, RATES, problem.roughness_min), []
    x, levels = (
        torch.randn((1, 3, prior.height, prior.width), generator=noise),
        subsequence(settings.steps),
    )
    with Bar(f"sample {seed}", len(levels)) as bar:
        for k, (t, s) in enumerate(zip(levels, list(levels[1:]) + [-1])):
            columns = int(rng.integers(prior.width))
            x = x.roll(columns, -1).requires_grad_(True)
            x0 = prior.denoise(x / np.sqrt(ALPHA_BAR[t]), sigma(t), settings.label)
            shaken = x0 + 0.05 * RANGE * torch.rand(x0.shape, generator=noise)
            radiance = scale * prior.decode(shaken)[0]
            light = np.ascontiguousarray(
                yaw_roll(radiance.detach().numpy().transpose(1, 2, 0), -columns)
            )
            guide, other = (
                problem.batch(settings.pixels, settings.spp, rng, int(v))
                for v in rng.integers(views, size=2)
            )
            g = problem.gradient(
                materials.explanation(light), guide, step_seed(rng), norm_loss(guide, not outdoor)
            )
            slope = torch.from_numpy(
                np.ascontiguousarray(yaw_roll(g.light, columns).transpose(2, 0, 1))
            )
            (pull,) = torch.autograd.grad((radiance * slope).sum(), x)
            a, b, deviation = posterior(int(t), int(s))
            with torch.no_grad():
                fresh = torch.randn(x.shape, generator=noise) if s >= 0 else torch.zeros_like(x)
                x = (
                    a * x0
                    + b * x
                    + deviation * fresh
                    - RANGE * rho_code(int(t), outdoor) * tame(pull)
                ).roll(-columns, -1)
            now = materials.explanation(light)
            materials.step(
                problem.gradient(now, other, step_seed(rng), norm_loss(other, not outdoor))
            )
            if k % GAUGE_EVERY == GAUGE_EVERY - 1:
                for name in ("base_color", "roughness"):
                    materials.values[name] /= max(float(materials.values[name].max()), 0.2)
            losses.append(g.loss)
            bar.step(f"loss {g.loss:.3f}")
    return guided_result(prior, x, scale, materials, losses[0], losses[-1])
