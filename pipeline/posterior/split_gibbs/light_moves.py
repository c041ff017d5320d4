"""Kernels that move the light: under the Gaussian prior, by decoupled annealing, by split Gibbs.

Split Gibbs (PnP-DM: Wu et al. 2024) splits the light's code in two that attract each other,

    pi(x, z) ~ p(x) exp(-|x - z|^2 / 2 rho^2) l(z)

and rho falls from a width of the prior to almost nothing. In turn: z | x, the photos' likelihood in
code space with a Gaussian about x (`photo_light`), and x | z, the prior seen through noise of width
rho, by the network's own reverse diffusion from there down (`prior_light`). The network is never
differentiated, and both leave the augmented posterior as it is up to the steps of the reverse
diffusion, so there is no guidance weight to tune.

Above widths at which log radiance is nearly linear, decoupled annealing (DAPS: Zhang et al. 2025)
goes before: noise on the code, the network's mean under it, and a draw about that mean with the
covariance that the Gaussian prior has under the same noise (`smooth_light`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import torch

from pipeline.posterior.split_gibbs.light_codes import (
    CodeLikelihood,
    Decoder,
    Modes,
    ModeUnknowns,
    PixelUnknowns,
)
from pipeline.posterior.split_gibbs.light_draw import SliceInfo, draw_light
from pipeline.posterior.split_gibbs.likelihood import Mixer, RowLikelihood
from pipeline.posterior.split_gibbs.state import Kernel, Randomness, State
from pipeline.prior.protocol import Prior
from pipeline.prior.sampling import lights, reverse_diffusion
from pipeline.prior.value_code import scale_of

PlaceLight = Callable[..., tuple[torch.Tensor, SliceInfo]]  # as `draw_light`


def noise_gain(log_spread: float, rho: float) -> float:
    """Mean factor by which code noise of width rho raises radiance exp(log_spread x + ...):
    exp((log_spread rho)^2 / 2).

    z is x plus such noise; without dividing by this, x has to be too dark for z to be right, and
    lags behind as rho falls.
    """
    return float(np.exp(0.5 * (log_spread * rho) ** 2))


def widths(count: int, first: float, last: float, stay: int) -> np.ndarray:
    """rho of every sweep: geometric from `first` to `last`, then `stay` more at `last`."""
    return np.concatenate([np.geomspace(first, last, count), np.full(stay, last)])


def prior_steps(rho: float) -> int:
    """Network calls of x | z: more where the gap is wide."""
    return int(np.clip(round(4 + 4 * np.log10(rho / 0.02)), 3, 14))


def _drawn(
    rng: Randomness,
    mixer: Mixer,
    state: State,
    decoder: Decoder,
    unknowns: PixelUnknowns | ModeUnknowns,
    about: torch.Tensor,
    start: torch.Tensor,
    place: PlaceLight = draw_light,
) -> tuple[torch.Tensor, State, SliceInfo]:
    """z drawn about `about`, begun at `start` (both without colours), or as `place` does, and the
    state with z's mean colours.
    """
    rows = RowLikelihood.of(mixer, state)
    likelihood = CodeLikelihood(rows, decoder, unknowns, state.log_scale)
    z, info = place(
        rng,
        likelihood,
        unknowns.about(about, len(state.materials)),
        unknowns.join(start, state.materials.color),
        unknowns.width,
    )
    materials = replace(state.materials, color=unknowns.colors(z))
    return z, replace(state, materials=materials), info


def gaussian_light(
    mixer: Mixer, decoder: Decoder, unknowns: ModeUnknowns, place: PlaceLight = draw_light
) -> Kernel:
    """Kernel: the light as modes of the Gaussian prior, with the regions' mean colours."""

    def kernel(rng: Randomness, state: State) -> tuple[State, SliceInfo]:
        about = torch.zeros(1, unknowns.size)
        z, state, info = _drawn(rng, mixer, state, decoder, unknowns, about, state.modes, place)
        coefficients = unknowns.coefficients(z)
        return replace(state, coefficients=coefficients, code=unknowns.code(coefficients)), info

    return kernel


def to_modes(unknowns: ModeUnknowns) -> Kernel:
    """Kernel: the code back among the modes, after moves of scale have changed its mean."""

    def kernel(rng: Randomness, state: State) -> tuple[State, None]:
        coefficients = unknowns.nearest(state.code)
        return replace(state, coefficients=coefficients, code=unknowns.code(coefficients)), None

    return kernel


def smooth_light(
    mixer: Mixer, decoder: Decoder, modes: Modes, sigma: float, label: str | None
) -> Kernel:
    """Kernel (Step 4a): one step of decoupled annealing at noise level sigma, with the mean
    colours.

    x ~ N(D(code + sigma n; sigma), (C^-1 + sigma^-2)^-1) l(x) with the network D, the Gaussian
    prior's covariance C and the likelihood l of the photos.
    """
    prior = decoder.prior

    def kernel(rng: Randomness, state: State) -> tuple[State, SliceInfo]:
        noise = torch.randn(state.code.shape, generator=rng.torch)
        noisy = (state.code + sigma * noise).reshape(1, 3, prior.height, prior.width)
        mean = prior.denoise(noisy, sigma, label).reshape(3, -1)
        unknowns = ModeUnknowns.seen(modes, mean, sigma)
        about = torch.zeros(1, unknowns.size)
        start = unknowns.nearest(state.code)
        z, state, info = _drawn(rng, mixer, state, decoder, unknowns, about, start)
        return replace(state, code=unknowns.code(unknowns.coefficients(z))), info

    return kernel


def split(rho: float) -> Kernel:
    """Kernel: the code becomes two, x as it is and z with noise of width rho."""

    def kernel(rng: Randomness, state: State) -> tuple[State, None]:
        noise = torch.randn(state.code.shape, generator=rng.torch)
        return replace(state, prior_code=state.code, code=state.code + rho * noise), None

    return kernel


def photo_light(mixer: Mixer, decoder: Decoder, rho: float) -> Kernel:
    """Kernel (Step 5a), z | x: the light's code given photos and its twin, with the mean colours.

    z ~ N(x, rho^2) l(z), by `light_draw.draw_light`.
    """

    def kernel(rng: Randomness, state: State) -> tuple[State, SliceInfo]:
        unknowns = PixelUnknowns(decoder.prior.height * decoder.prior.width, rho)
        z, state, info = _drawn(rng, mixer, state, decoder, unknowns, state.twin, state.code)
        return replace(state, code=unknowns.code(z)), info

    return kernel


def pull_of_twin(prior: Prior, rho: float) -> Callable[[State], Callable[[np.ndarray], float]]:
    """For `material_moves.gauge_kernel`: log-density of a shift (3,) of z's log radiance per
    channel, for the Gaussian of width rho between z and x.
    """

    def pull_of(state: State) -> Callable[[np.ndarray], float]:
        gap = (state.code - state.twin).mean(1).numpy()
        pixels = state.code.shape[1]

        def pull(shift: np.ndarray) -> float:
            moved = (gap + shift / prior.log_spread) ** 2
            return float(-0.5 * pixels * (moved - gap**2).sum() / rho**2)

        return pull

    return pull_of


def prior_light(prior: Prior, rho: float, label: str | None) -> Kernel:
    """Kernel (Step 5d), x | z: the twin given the light's code, by reverse diffusion.

    x ~ p(x) N(z; x, rho^2): what the prior makes of a code seen through noise of width rho.
    """

    def kernel(rng: Randomness, state: State) -> tuple[State, int]:
        z = state.code.reshape(1, 3, prior.height, prior.width)
        steps = prior_steps(rho)
        x = reverse_diffusion(prior, z, rho, steps, label, rng.numpy, rng.torch)
        return replace(state, prior_code=x.reshape(3, -1)), steps

    return kernel


def scale_of_one(prior: Prior) -> Kernel:
    """Kernel (Step 4d, Step 5e): what a code is over scale one goes to the light's scale; the
    radiance stays.

    The prior's maps were all of scale one (prior/value_code.py). The photos move the code's mean:
    under a scale that stood still it would be where the network has never been, and be pulled back.
    While the code is split the twin decides, for it is the one that the network makes.
    """

    def kernel(rng: Randomness, state: State) -> tuple[State, float]:
        whole = state.code if state.prior_code is None else state.prior_code
        light = lights(prior, whole.reshape(1, 3, prior.height, prior.width))[0]
        over = float(np.log(scale_of(light)))
        log_scale = state.log_scale + over
        moved = whole - over / prior.log_spread
        if state.prior_code is None:
            return replace(state, code=moved, log_scale=log_scale), over
        code = state.code - (log_scale - state.log_scale) / prior.log_spread
        return replace(state, code=code, prior_code=moved, log_scale=log_scale), over

    return kernel
