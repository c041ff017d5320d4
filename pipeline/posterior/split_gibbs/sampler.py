"""`split_gibbs`, the default sampler: one posterior draw of light and materials.

`chain` shows the whole loop. Its steps have the numbers of docs/method.md, section 5; every kernel
is a function `kernel(rng, state) -> state, info` over a frozen state (state.py).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Generator, Iterator
from dataclasses import replace

import numpy as np
import torch

from pipeline.base.config import Sample
from pipeline.base.progress import Bar
from pipeline.posterior.problem import Problem
from pipeline.posterior.split_gibbs.draw_maps import explanation
from pipeline.posterior.split_gibbs.free_level import free_level
from pipeline.posterior.split_gibbs.light_draw import draw_light, likeliest_light
from pipeline.posterior.split_gibbs.light_moves import (
    PlaceLight,
    gaussian_light,
    noise_gain,
    photo_light,
    prior_light,
    pull_of_twin,
    scale_of_one,
    smooth_light,
    split,
    to_modes,
    widths,
)
from pipeline.posterior.split_gibbs.light_tint import held_tint
from pipeline.posterior.split_gibbs.material_moves import (
    categorical,
    gauge_kernel,
    material_kernel,
    propose_color,
    scale_only,
)
from pipeline.posterior.split_gibbs.material_prior import log_prior
from pipeline.posterior.split_gibbs.setup import Model, set_up
from pipeline.posterior.split_gibbs.starts import FewRows
from pipeline.posterior.split_gibbs.state import Randomness, RegionMaterials, State, run
from pipeline.posterior.split_gibbs.thinning import explained, thinning
from pipeline.prior.gaussian import translated
from pipeline.prior.protocol import Prior
from pipeline.render.renderer import Explanation

# widths of the splitting in code units, where the prior's deviation is 0.5; above FIRST, log
# radiance is far from linear
FIRST, LAST = 0.15, 0.02
# noise level of the first smooth sweep, several times a code's deviation: the light that a start
# was fitted to is forgotten but for what the photos say of it
SMOOTH = 2.0
# sweeps under the Gaussian prior: of the starts, without some photos and then with all (every row
# counts in full: what they leave over shows the noise's correlation), and then with rows thinned
# (the last sweeps that move the light's brightness freely, so with the errors it has)
KIND_SWEEPS, FIRST_SWEEPS, THINNED_SWEEPS = 1, 2, 1
# further sweeps of the one start that is taken: how often, and how many before its odds decide
TURNS, TURN_SWEEPS = 6, 2
# starts that take sweeps; one whose log odds are so far below the best's takes none
MOST, BEHIND = 4, 150.0
# material steps at a start's light, for colours and noise: it is too smooth to tell of gloss
WARM_UP_STEPS = 50


def chain(rng: Randomness, model: Model, state: State, title: str) -> Iterator[State]:
    """On the way to one draw from p(light, materials, noise | photos), steps 2 to 5 in order: what
    the chain would end as if it stopped there, after every part of the start and every sweep. The
    last one is the draw.

    model, state: of step 1 (setup.py). The codes of what is given are ones of the diffusion prior.
    """
    mixer, prior, settings = model.mixer, model.prior, model.settings
    centre, label, steps = model.log_scale_centre, settings.label, settings.region_steps

    # 2  Start: materials by their evidence, then sweeps under the Gaussian prior; 3  thinning
    state = yield from start(rng, model, state)

    noise_levels = np.geomspace(SMOOTH, FIRST, settings.smooth)
    rhos = widths(settings.levels, FIRST, LAST, settings.stay)
    with Bar(title, len(noise_levels) + len(rhos)) as bar:
        # 4  Smooth sweeps: decoupled annealing
        decoder, modes = model.decoder(prior), model.modes(prior)
        for sigma in map(float, noise_levels):
            for kernel in (
                smooth_light(mixer, decoder, modes, sigma, label),  # 4a  light, mean colours
                gauge_kernel(mixer, decoder, centre, lambda _: scale_only),  # 4b  scale | colours
                material_kernel(mixer, decoder, steps),  # 4c  materials, offsets, noise
                scale_of_one(prior),  # 4d  the code's mean goes to the scale
                held_tint(decoder, model.tint),  # 4e  the tint that the surroundings show
            ):
                state, _ = kernel(rng, state)
            bar.step(f"error {100 * state.noise.scale:.1f} %")
            yield state

        # 5  Split sweeps: split Gibbs, the two codes nearer and nearer to each other
        state, _ = split(float(rhos[0]))(rng, state)
        for rho in map(float, rhos):
            decoder = model.decoder(prior, noise_gain(prior.log_spread, rho))
            for kernel in (
                photo_light(mixer, decoder, rho),  # 5a  z | x: light, mean colours given photos
                gauge_kernel(mixer, decoder, centre, pull_of_twin(prior, rho)),  # 5b
                material_kernel(mixer, decoder, steps),  # 5c
                prior_light(prior, rho, label),  # 5d  x | z: light given prior
                scale_of_one(prior),  # 5e
                held_tint(decoder, model.tint),  # 5f
            ):
                state, _ = kernel(rng, state)
            bar.step(f"error {100 * state.noise.scale:.1f} %")
            yield replace(state, code=state.twin, prior_code=None)


def last_of(states: Iterator[State]) -> State:
    """Where a chain ends. None of the states before is kept."""
    (last,) = deque(states, maxlen=1)
    return last


def start(rng: Randomness, model: Model, state: State) -> Generator[State, None, State]:
    """Steps 2 and 3: the best start after 2b, the one taken after 2d, and a draw under the Gaussian
    prior, which is returned too. Their codes are ones of the diffusion prior.
    """
    settings = model.settings

    # 2a  whole objects of one gloss, each with a light of its own
    some = model.without_some_photos(rng.numpy)
    few = FewRows.over(some.data, model.gaussian, state.log_scale, settings.start_points, rng.numpy)
    found = few.starts(state.materials, rng.numpy)

    # 2b  metal or not, by how well the other photos are explained
    states = [begun(rng, some, state, *materials_and_code) for materials_and_code in found]
    states, best = of_better_kind(rng, some, states)
    yield as_diffusion(model, best)

    # 2c  which of these, by how well all photos are
    state = best_after_sweeps(rng, model, states)

    # 2d  the points' materials and the light go on until they fit
    state = swept_on(rng, model, state)
    yield as_diffusion(model, state)

    # 3  rows that err together count less
    state, _ = thinning(model)(rng, state)
    state = as_diffusion(model, gaussian_sweeps(rng, model, state, THINNED_SWEEPS))
    yield state
    return state


def as_diffusion(model: Model, state: State) -> State:
    """A state of the Gaussian prior with its code as one of the diffusion prior."""
    gaussian = model.gaussian
    code = state.code.reshape(1, 3, gaussian.height, gaussian.width)
    return replace(
        state, code=translated(code, gaussian, model.prior).reshape(3, -1), coefficients=None
    )


def begun(
    rng: Randomness, model: Model, state: State, materials: RegionMaterials, code: torch.Tensor
) -> State:
    """A state at materials and a code (3, m) of the Gaussian prior, its colours and noise
    settled.
    """
    decoder = model.decoder(model.gaussian)
    state = replace(state, materials=materials, code=code)
    state, _ = held_tint(decoder, model.tint)(rng, state)
    state = replace(state, coefficients=model.gaussian_unknowns.nearest(state.code))
    state, _ = material_kernel(model.mixer, decoder, WARM_UP_STEPS, propose_color)(rng, state)
    return state


def of_better_kind(rng: Randomness, model: Model, states: list[State]) -> tuple[list[State], State]:
    """Step 2b: of the best few states, after a sweep, those that are metal if the best one is, or
    not if it is not; and the best one.
    """
    odds = odds_of(rng, model, states)
    near = int((odds > odds.max() - BEHIND).sum())
    states = swept(rng, model, best_of(states, odds, min(MOST, near)), KIND_SWEEPS)
    best = states[odds_of(rng, model, states).argmax()]
    metal = mostly_metal(model, best)
    return [state for state in states if mostly_metal(model, state) == metal], best


def best_after_sweeps(rng: Randomness, model: Model, states: list[State]) -> State:
    """Step 2c: one of the states after more sweeps, drawn by its odds."""
    states = swept(rng, model, states, FIRST_SWEEPS)
    odds = odds_of(rng, model, states)
    return states[categorical(odds[None], rng.numpy)[0]]


def swept_on(rng: Randomness, model: Model, state: State) -> State:
    """Step 2d: the state after further sweeps, a few at a time, each time taken or not by its odds,
    as in a Metropolis step.
    """
    odds = log_odds(rng, model, state)
    for _ in range(TURNS):
        moved = gaussian_sweeps(rng, model, state, TURN_SWEEPS, likeliest_light)
        then = log_odds(rng, model, moved)
        if np.log(rng.numpy.random()) < then - odds:
            state, odds = moved, then
    return state


def swept(rng: Randomness, model: Model, states: list[State], count: int) -> list[State]:
    """Every state after `count` sweeps whose lights are likeliest ones: draws cost more, and tell
    no more of which state is better.
    """
    return [gaussian_sweeps(rng, model, state, count, likeliest_light) for state in states]


def mostly_metal(model: Model, state: State) -> bool:
    """Whether more than half of the points are of metal."""
    return bool(state.materials.metallic[model.data.region].mean() > 0.5)


def best_of(states: list[State], odds: np.ndarray, count: int) -> list[State]:
    """The `count` states of the greatest log odds, the best one first."""
    return [states[k] for k in np.argsort(-odds)[:count]]


def odds_of(rng: Randomness, model: Model, states: list[State]) -> np.ndarray:
    """Log odds of each state."""
    return np.array([log_odds(rng, model, state) for state in states])


def log_odds(rng: Randomness, model: Model, state: State) -> float:
    """Of a state's materials, and of how well it explains the photos it was not told of, or all if
    it was told of all.
    """
    prior = log_prior(state.materials, model.data.lobes.roughness)
    return explained(rng, model, state) + prior


def gaussian_sweeps(
    rng: Randomness,
    model: Model,
    state: State,
    count: int,
    place: PlaceLight = draw_light,
) -> State:
    """Sweeps over light, scale, materials, noise, with the light as modes of the Gaussian prior
    where `place` puts them.
    """
    mixer, gaussian = model.mixer, model.gaussian
    decoder, unknowns = model.decoder(gaussian), model.gaussian_unknowns
    kernels = (
        gaussian_light(mixer, decoder, unknowns, place),
        gauge_kernel(mixer, decoder, model.log_scale_centre, lambda _: scale_only),
        material_kernel(mixer, decoder, model.settings.region_steps),
        scale_of_one(gaussian),
        held_tint(decoder, model.tint),
        to_modes(unknowns),
    )
    return run(rng, state, *(kernels * count))


def with_level(rng: Randomness, model: Model, state: State) -> State:
    """Step 6: the level as free as the photos are badly explained."""
    decoder = model.decoder(model.prior)
    return run(rng, state, free_level(model.mixer, decoder, model.log_scale_centre))


def split_gibbs(
    problem: Problem, prior: Prior, fit: Explanation, settings: Sample, seed: int
) -> tuple[Explanation, dict]:
    """One posterior sample; `fit` is the point estimate.

    Deterministic in `seed`: independent of other samples and of what ran before in the process.
    """
    rng, model, state = set_up(problem, prior, fit, settings, seed)  # 1  set-up
    with torch.no_grad():
        state = last_of(chain(rng, model, state, f"sample {seed}"))  # 2 to 5
        state = with_level(rng, model, state)  # 6  level
        return explanation(rng, model, state, fit)  # 7  maps


def gaussian(
    problem: Problem, prior: Prior, fit: Explanation, settings: Sample, seed: int
) -> tuple[Explanation, dict]:
    """One posterior sample under the Gaussian prior `settings.start_prior`: steps 1 to 3, 6 and 7;
    `prior` gives the size of the light only.
    """
    rng, model, state = set_up(problem, prior, fit, settings, seed)
    with torch.no_grad():
        state = with_level(rng, model, last_of(start(rng, model, state)))
        return explanation(rng, model, state, fit)
