"""Step 3 of split_gibbs: how many rows stand for an independent one, how well all are explained.

Both look at what the drawn colours leave over.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pipeline.posterior.split_gibbs.likelihood import RowLikelihood
from pipeline.posterior.split_gibbs.noise import channel_effect, log_noise, neighbour_effect
from pipeline.posterior.split_gibbs.setup import Model
from pipeline.posterior.split_gibbs.starts import THINNING
from pipeline.posterior.split_gibbs.state import Kernel, Randomness, State


def thinning(model: Model) -> Kernel:
    """Kernel (Step 3), run once: measures the design effect from the residuals under the state's
    light.
    """

    def kernel(rng: Randomness, state: State) -> tuple[State, float]:
        data = model.data
        rows, U, W, colors = drawn_colors(rng, model, state)
        residual = data.observed - colors[data.rows.point] * U - W
        residual = residual * np.sqrt(rows.model.counted(U, W, state.materials))

        position = data.transport.position
        neighbours = neighbour_effect(data.rows, position, model.view, residual.mean(1))
        effect = channel_effect(residual) * neighbours
        return replace(state, noise=replace(state.noise, design_effect=effect)), effect

    return kernel


def explained(rng: Randomness, model: Model, state: State) -> float:
    """Log odds of how well a state of the start explains the rows that it was not told of, taken
    for all rows and thinned as in the starts, and what is seen of the light. Where it was told of
    all rows, of how well it explains those.
    """
    rows, U, W, colors = drawn_colors(rng, model, state)
    data = model.data
    asked = np.ones_like(data.told) if data.told.all() else ~data.told
    judge = replace(rows.model, data=replace(data, told=asked))
    of_all = log_noise(judge, U, W, colors) / asked.mean()
    light = model.decoder(model.gaussian).light(state.code, state.log_scale)
    return of_all / THINNING + data.seen_light.value(light)


def drawn_colors(
    rng: Randomness, model: Model, state: State
) -> tuple[RowLikelihood, np.ndarray, np.ndarray, np.ndarray]:
    """The rows at a state of the start, what the lobes see U and W (n, 3), drawn colours (p, 3)."""
    rows = RowLikelihood.of(model.mixer, state)
    light = model.decoder(model.gaussian).light(state.code, state.log_scale)
    return rows, *rows.draw_colors(light, rng.numpy)
