"""The light's tint as what photos show around the object has it."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from pipeline.posterior.split_gibbs.light_codes import Decoder
from pipeline.posterior.split_gibbs.light_tint import AROUND, MAPS, drawn_tint, held_tint
from pipeline.posterior.split_gibbs.state import Noise, Randomness, RegionMaterials, State
from pipeline.prior.load import load_gaussian
from pipeline.render.envmap import mean_radiance
from pipeline.render.surroundings import Around
from pipeline.render.tint import TINTS, tint_of
from tests.seeds import numpy_rng, torch_rng

TINT = np.array([0.3, -0.1])


def around(tint: np.ndarray) -> Around:
    """Surroundings of a tint (2,)."""
    return Around(0.2 * np.exp(tint @ TINTS))


def test_tints_of_colours():
    """Brightness is none of it; what a light's tint adds to a colour's is the product's."""
    rng = numpy_rng(0)
    a, b = rng.uniform(0.1, 1, (2, 5, 3))
    np.testing.assert_allclose(tint_of(np.full(3, 0.3)), 0, atol=1e-12)
    np.testing.assert_allclose(tint_of(7 * a), tint_of(a))
    np.testing.assert_allclose(tint_of(a * b), tint_of(a) + tint_of(b))
    assert tint_of(np.array([0.5, 0.4, 0.3]))[0] > 0


def test_surroundings_tell_of_the_tint_and_no_more_than_they_know():
    """Draws have the posterior's mean and deviation by sums over a grid; none where nothing is
    around.
    """
    assert drawn_tint(None, numpy_rng(1)) is None
    usual, width = MAPS
    axis = np.linspace(-1.5, 1.5, 301)
    grid = np.stack(np.meshgrid(axis, axis, indexing="ij"), -1)
    normal = lambda x, deviation: np.exp(-0.5 * ((x / deviation) ** 2).sum(-1)) / deviation.prod()
    for shown in (np.zeros(2), np.array([0.6, -0.1]), np.array([0.4, 0.3])):
        seen = sum(own.share * normal(shown - grid - own.mean, own.width) for own in AROUND)
        density = normal(grid - usual, width) * seen
        density /= density.sum()
        mean = (grid * density[..., None]).sum((0, 1))
        deviation = np.sqrt(((grid - mean) ** 2 * density[..., None]).sum((0, 1)))
        rng = numpy_rng(2)
        drawn = np.array([drawn_tint(around(shown), rng) for _ in range(4000)])
        np.testing.assert_allclose(drawn.mean(0), mean, atol=0.02)
        np.testing.assert_allclose(drawn.std(0), deviation, rtol=0.1)


def test_lawns_and_green_screens_make_no_green_light():
    """What is dyed as no light is says little of it."""
    rng = numpy_rng(3)

    def green_light(green: float) -> float:
        shown = around(np.array([0.2, green]))
        return float(np.mean([drawn_tint(shown, rng)[1] for _ in range(500)]))

    assert green_light(0.6) < 0.1
    assert green_light(0.1) > 0.03


@pytest.fixture
def decoder() -> Decoder:
    return Decoder.onto(load_gaussian("gaussian_tiny"), 8)


@pytest.fixture
def state(decoder) -> State:
    """A light of some tint on two colours, one of them nearly white."""
    prior = decoder.prior
    code = 0.3 * torch.randn((3, 2 * prior.height**2), generator=torch_rng(3))
    code = code + torch.tensor([[0.5], [0.0], [-0.5]])
    materials = RegionMaterials(
        np.array([[0.3, 0.2, 0.4], [0.2, 0.1, 0.15]]),
        np.full(2, 0.3),
        np.zeros(2, int),
        np.zeros(2),
    )
    step = np.full(2, 0.05)
    return State(code, 0.7, materials, np.zeros((3, 4), int), Noise(0.1, np.ones(4)), step, step)


def mean_of(decoder: Decoder, code: torch.Tensor, log_scale: float) -> np.ndarray:
    return mean_radiance(decoder.map(code, log_scale))


def rng() -> Randomness:
    return Randomness(numpy_rng(4), torch_rng(5))


def test_the_tint_is_held_and_what_is_matt_looks_as_before(decoder, state):
    held, shift = held_tint(decoder, TINT)(rng(), state)
    before = mean_of(decoder, state.code, state.log_scale)
    after = mean_of(decoder, held.code, held.log_scale)
    np.testing.assert_allclose(tint_of(after), TINT, atol=2e-3)
    np.testing.assert_allclose(np.exp(shift) * before, after, rtol=2e-3)
    np.testing.assert_allclose(
        held.materials.color * after, state.materials.color * before, rtol=2e-3
    )
    assert abs(shift.sum()) < 1e-9 and np.abs(shift).max() > 0.1
    again, more = held_tint(decoder, TINT)(rng(), held)
    assert np.abs(more).max() < 2e-3


def test_without_a_tint_nothing_moves(decoder, state):
    held, shift = held_tint(decoder, None)(rng(), state)
    assert held is state and not shift.any()


def test_colours_stay_possible(decoder, state):
    """Where the shift would take them out of what surfaces reflect."""
    bright = replace(state.materials, color=np.full((2, 3), 0.97))
    held, _ = held_tint(decoder, np.array([-1.0, 0.0]))(rng(), replace(state, materials=bright))
    assert (held.materials.color < 0.98).all() and (held.materials.color > 0).all()


def test_the_twin_decides_while_the_code_is_split(decoder, state):
    """It gets the tint, and the code goes with it."""
    twin = state.code + torch.tensor([[0.1], [0.0], [0.2]])
    held, _ = held_tint(decoder, TINT)(rng(), replace(state, prior_code=twin))
    np.testing.assert_allclose(tint_of(mean_of(decoder, held.twin, 0.0)), TINT, atol=2e-3)
    np.testing.assert_allclose(
        (held.code - held.twin).numpy(), (state.code - twin).numpy(), atol=1e-5
    )
