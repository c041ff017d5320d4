"""A draw of z from likelihood(z) x N(z; x, rho^2): light given photos, z | x.

Randomised maximum likelihood (Oliver et al. 1996; Bardsley et al. 2014: perturb data and prior
mean, then optimise), exact where the log-likelihood is quadratic, and elliptical slices from there
(Murray et al. 2010; Nishihara et al. 2014). Slices alone turn by small angles where the Gaussian
about the peak is a poor one, and do not get round in a few sweeps.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import torch

from pipeline.posterior.split_gibbs.gaussian_approximation import (
    GaussianApproximation,
    LightLikelihood,
    approximate,
)
from pipeline.posterior.split_gibbs.state import Randomness

SLICES = 3
# bracket of angles (radians) below which a slice is numerically back at its start
CLOSED = 1e-6


class SliceInfo(NamedTuple):
    """tries: points looked at; moved: slices that ended elsewhere."""

    tries: int
    moved: int


def elliptical_slices(
    rng: Randomness,
    z: torch.Tensor,
    log_density: Callable[[torch.Tensor], float],
    reference: GaussianApproximation,
    slices: int,
) -> tuple[torch.Tensor, SliceInfo]:
    """`slices` steps from z that leave exp(log_density) unchanged; `reference` only decides how
    well they mix.
    """
    offset = z - reference.mode
    image = reference.image(offset)
    now = log_density(z) + reference.energy(offset, image)
    tries, moved = 0, 0
    for _ in range(slices):
        threshold = now + np.log(rng.numpy.random())
        fresh = reference.draw(rng.torch)
        fresh_image = reference.image(fresh)
        angle = rng.numpy.uniform(0, 2 * np.pi)
        low, high = angle - 2 * np.pi, angle

        while True:
            tries += 1
            c, s = np.cos(angle), np.sin(angle)
            turned = c * offset + s * fresh
            turned_image = c * image + s * fresh_image
            then = log_density(reference.mode + turned) + reference.energy(turned, turned_image)
            if then > threshold:
                offset, image, now = turned, turned_image, then
                moved += 1
                break
            low, high = (angle, high) if angle < 0 else (low, angle)
            if high - low < CLOSED:
                break
            angle = rng.numpy.uniform(low, high)
    return reference.mode + offset, SliceInfo(tries, moved)


def likeliest_light(
    rng: Randomness, likelihood: LightLikelihood, x: torch.Tensor, z: torch.Tensor, rho: float
) -> tuple[torch.Tensor, SliceInfo]:
    """The peak of what `draw_light` draws from, for the same arguments; nothing is drawn."""
    return approximate(likelihood, x, z, rho).mode, SliceInfo(0, 0)


def draw_light(
    rng: Randomness,
    likelihood: LightLikelihood,
    x: torch.Tensor,
    z: torch.Tensor,
    rho: float,
    slices: int = SLICES,
) -> tuple[torch.Tensor, SliceInfo]:
    """z | x: unknowns like x (C, M) from likelihood(z) x N(z; x, rho^2); z is where to look for the
    peak.

    Data and x are moved by fresh noise and the peak of that is found; slices about the Gaussian at
    the unmoved peak correct for what is not quadratic.
    """
    reference = approximate(likelihood, x, z, rho)
    fresh = lambda shape: torch.randn(shape, generator=rng.torch)
    about = x + rho * fresh(x.shape)
    noise = fresh(reference.J.shape[:2])
    start = approximate(likelihood, about, reference.mode, rho, noise, known=reference).mode

    log_density = lambda t: likelihood.value(t) - 0.5 * float((t - x).square().sum()) / rho**2
    return elliptical_slices(rng, start, log_density, reference, slices)
