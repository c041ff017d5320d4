"""Step 6 of split_gibbs: the light's level, where the photos are explained badly.

Brighter light on darker surfaces gives nearly the same photos. What tells the two apart is small,
highlights and light between parts of the object, and where cameras, surface or photos are wrong it
is smaller than what the model misses. The model's errors are then of one kind all over, and many
rows make a wrong level no less sure. So the level is drawn once more, all else held, from

    prior x likelihood^w,    w = min(1, (ERROR / eta)^POWER)

with eta the rows' relative error: a coarsened posterior (Miller and Dunson 2019), of the level
alone. With the whole likelihood so flattened light and colours fit too loosely
(docs/experiments.md).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pipeline.posterior.split_gibbs.light_codes import Decoder
from pipeline.posterior.split_gibbs.likelihood import Mixer, RowLikelihood
from pipeline.posterior.split_gibbs.material_moves import beside_photos, of_photos
from pipeline.posterior.split_gibbs.state import Kernel, Randomness, State

# relative error up to which the photos' word on the level is taken in full: scenes whose cameras
# and surface are right are explained to .05 or better; and how fast it counts less beyond
ERROR, POWER = 0.06, 5
# shifts of log radiance that are looked at: up to so far either way, and how many
REACH, SHIFTS = 2.0, 161


def weight_of_photos(error: float) -> float:
    """w, in (0, 1], for rows of the relative error `error`."""
    return min(1.0, (ERROR / error) ** POWER)


def free_level(mixer: Mixer, decoder: Decoder, centre: float) -> Kernel:
    """Kernel (Step 6): log scale against all mean colours, drawn from a grid; nothing is drawn
    where the photos count in full.

    centre: mean of the log scale's prior. Its info is the shift of log radiance.
    """

    def kernel(rng: Randomness, state: State) -> tuple[State, float]:
        weight = weight_of_photos(state.noise.scale)
        if weight == 1:
            return state, 0.0
        rows = RowLikelihood.of(mixer, state)
        light = decoder.light(state.code, state.log_scale)
        lit = rows.lit(light)
        roughness = mixer.data.lobes.roughness

        def log_density(shift: float) -> float:
            moved = shifted(state, shift)
            photos = of_photos(rows, lit, light, moved.materials, np.full(3, np.exp(shift)))
            beside = beside_photos(moved.materials, moved.log_scale, centre, roughness)
            return weight * photos + beside

        shifts = np.linspace(-REACH, REACH, SHIFTS)
        odds = np.array([log_density(shift) for shift in shifts])
        drawn = shifts[(odds + rng.numpy.gumbel(size=SHIFTS)).argmax()]
        shift = drawn + rng.numpy.uniform(-0.5, 0.5) * (shifts[1] - shifts[0])
        return shifted(state, shift), float(shift)

    return kernel


def shifted(state: State, shift: float) -> State:
    """A state of `shift` more log radiance, its mean colours darker by as much."""
    color = state.materials.color * np.exp(-shift)
    materials = replace(state.materials, color=color)
    return replace(state, log_scale=state.log_scale + shift, materials=materials)
