"""Step 1 and Steps 4e, 5f of split_gibbs: the light's tint, where photos show what is around.

A warm light on a grey thing gives nearly the same photos as a neutral light on a warm thing. What
tells them apart is small, highlights and light from part to part, and where cameras or surface are
wrong it is smaller than what the model misses: edges that one photo shows a pixel beside where the
next one does look like reflections of the colours next to them, and yellow things got yellow
lights. What photos show around the object is the incoming light itself, lamps and windows and what
those light, and tells of its tint whatever the object is like. So a draw's light has the tint

    t ~ N(m, S),    S^-1 = A^-1 + B^-1,    m = S (A^-1 a + B^-1 (t' - b))

a, A being mean and variance of measured maps' tints (MAPS), t' the tint of what is around, which is
off the light's by b, B: those of tables and walls, or of a lawn or a coloured backdrop, drawn by
how well they explain t' (AROUND). The chain is held to t: the rows have no word on it. That is a
"cut" (Plummer 2015): what is known better from elsewhere is not corrected by a part of the model
that is known to be wrong.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import torch

from pipeline.posterior.problem import ALBEDO_MAX
from pipeline.posterior.split_gibbs.light_codes import Decoder
from pipeline.posterior.split_gibbs.state import Kernel, Randomness, State
from pipeline.render.envmap import mean_radiance
from pipeline.render.surroundings import Around
from pipeline.render.tint import TINTS, tint_of

# mean and deviation of the tint of the mean radiance of 200 measured maps, those that the prior of
# light was trained on
MAPS = np.array([0.04, -0.01]), np.array([0.31, 0.09])


class Own(NamedTuple):
    """A kind of surroundings: what share of all they are; mean and deviation of their own tint, by
    which what photos show of them is off the light's.
    """

    share: float
    mean: np.ndarray
    width: np.ndarray


# tables and walls are warm themselves (things of benchmarks.tabletop have .23 and .16); lawns and
# coloured backdrops are as dyed as single materials (material_prior.DIELECTRIC_TINT)
AROUND = (
    Own(0.85, np.array([0.2, 0.0]), np.array([0.2, 0.06])),
    Own(0.15, np.array([0.2, 0.0]), np.array([0.5, 0.3])),
)
# the darkest mean colour that a shift leaves
DARKEST = 1e-4


def drawn_tint(around: Around | None, rng: np.random.Generator) -> np.ndarray | None:
    """The tint (2,) of a draw's light; None where photos show nothing around."""
    if around is None:
        return None
    (prior, width), seen = MAPS, tint_of(around.radiance)

    def log_odds(own: Own) -> float:
        spread = width**2 + own.width**2
        gap = (seen - prior - own.mean) ** 2 / spread
        return float(np.log(own.share) - 0.5 * (gap + np.log(spread)).sum())

    odds = np.array([log_odds(own) for own in AROUND])
    own = AROUND[(odds + rng.gumbel(size=len(AROUND))).argmax()]
    precision = width**-2 + own.width**-2
    mean = (width**-2 * prior + own.width**-2 * (seen - own.mean)) / precision
    return mean + rng.normal(size=2) / np.sqrt(precision)


def held_tint(decoder: Decoder, tint: np.ndarray | None) -> Kernel:
    """Kernel (Step 4e, Step 5f): the light's mean radiance has the `tint` again, and the mean
    colours have what it had too much, so that what is matt looks as before. Its info is the shift
    of log radiance (3,). While the code is split the twin decides. Nothing where there is no tint.
    """

    def kernel(rng: Randomness, state: State) -> tuple[State, np.ndarray]:
        if tint is None:
            return state, np.zeros(3)
        whole = state.code if state.prior_code is None else state.prior_code
        shift = (tint - tint_of(mean_radiance(decoder.map(whole, 0.0)))) @ TINTS

        of_code = torch.from_numpy((shift / decoder.prior.log_spread).astype(np.float32))[:, None]
        twin = None if state.prior_code is None else state.prior_code + of_code
        color = np.clip(state.materials.color * np.exp(-shift), DARKEST, 0.99 * ALBEDO_MAX)
        materials = replace(state.materials, color=color)
        code = state.code + of_code
        return replace(state, code=code, prior_code=twin, materials=materials), shift

    return kernel
