"""Runs of samplers that may be stopped early, and what each would return then."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import torch

from pipeline.base.config import Sample
from pipeline.posterior.dpi import as_published
from pipeline.posterior.dpi.light_of_code import finished_sample
from pipeline.posterior.problem import Problem
from pipeline.posterior.split_gibbs import sampler
from pipeline.posterior.split_gibbs.draw_maps import explanation
from pipeline.posterior.split_gibbs.light_moves import widths
from pipeline.posterior.split_gibbs.setup import Model, set_up
from pipeline.posterior.split_gibbs.state import Randomness, State
from pipeline.prior.protocol import Prior
from pipeline.render.renderer import Explanation

STARTED = 3  # stops of split_gibbs before its first sweep under the diffusion prior

Stop = Callable[[], Explanation]  # what a run that stops here returns, before refinement


@dataclass(frozen=True)
class Run:
    """`count` stops, the last of which is the whole run. A stop is asked before the next is."""

    count: int
    stops: Iterator[Stop]


def of_split_gibbs(
    problem: Problem, prior: Prior, fit: Explanation, settings: Sample, seed: int
) -> Run:
    """A stop after every part of the start and every sweep."""
    sweeps = settings.smooth + len(
        widths(settings.levels, sampler.FIRST, sampler.LAST, settings.stay)
    )

    @torch.no_grad()
    def stops() -> Iterator[Stop]:
        rng, model, begun = set_up(problem, prior, fit, settings, seed)
        for state in sampler.chain(rng, model, begun, f"anytime {seed}"):
            yield lambda state=state: ended(rng, model, state, fit)

    return Run(STARTED + sweeps, stops())


@torch.no_grad()
def ended(rng: Randomness, model: Model, state: State, fit: Explanation) -> Explanation:
    """Steps 6 and 7 from a state. The chain's random numbers stay as they are."""
    aside = copied(rng)
    return explanation(aside, model, sampler.with_level(aside, model, state), fit)[0]


def copied(rng: Randomness) -> Randomness:
    """Random numbers that go on alike."""
    numpy = type(rng.numpy)(type(rng.numpy.bit_generator)())
    numpy.bit_generator.state = rng.numpy.bit_generator.state
    noise = torch.Generator()
    noise.set_state(rng.torch.get_state())
    return Randomness(numpy, noise)


def of_dpi_paper(
    problem: Problem, prior: Prior, fit: Explanation, settings: Sample, seed: int
) -> Run:
    """A stop after every level: with the network's estimate x_0 as its light."""

    def stops() -> Iterator[Stop]:
        scale, materials = as_published.begun(problem, fit, settings)
        turns = as_published.turns(problem, prior, scale, materials, settings, seed)
        for number, turn in enumerate(turns, 1):
            code = turn.code if number == settings.steps else turn.clean
            yield lambda code=code: finished_sample(prior, code, scale, materials)

    return Run(settings.steps, stops())


RUNS = {"split_gibbs": of_split_gibbs, "dpi_paper": of_dpi_paper}  # by the sampler's name
