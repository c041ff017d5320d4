"""Moves of the light's level against the base colours, and what tells of it."""

from dataclasses import replace

import numpy as np
import pytest

from pipeline.posterior.split_gibbs import free_level
from pipeline.posterior.split_gibbs.likelihood import Mixer, RowLikelihood
from pipeline.posterior.split_gibbs.lobes import LobeTable
from pipeline.posterior.split_gibbs.material_moves import SCALE_PRIOR, draw_gauge
from pipeline.posterior.split_gibbs.material_prior import log_prior
from pipeline.posterior.split_gibbs.row_model import RowData
from pipeline.posterior.split_gibbs.state import Noise, Randomness, RegionMaterials, State
from pipeline.render.rows import choose_rows
from pipeline.render.transport import Transport
from tests.render.test_transport import bowl  # noqa: F401  (fixture)
from tests.seeds import numpy_rng, seeded

POINTS, BOUNCES = 40, 6
GAINS = np.array([[1.0, 1.0, 1.0], [1.7, 1.7, 1.7], [0.4, 1.0, 2.0]])


@pytest.fixture(scope="module")
def in_bowl(bowl) -> RowLikelihood:  # noqa: F811
    """Rows of a bowl of two matt colours, as they look under `even`."""
    renderer, observations = bowl
    rows = choose_rows(observations, renderer.scene, POINTS, 2, seeded(0))
    transport = Transport(renderer.scene, renderer.mesh, observations, rows, 8, 40, seeded(1))
    table = LobeTable.trace(transport, 0.5, seeded(0))
    region = numpy_rng(2).integers(0, 2, POINTS)
    blank = RowData.plain(transport, table, np.ones((len(rows.point), 3)), region, BOUNCES)
    materials = RegionMaterials(
        color=np.array([[0.75, 0.6, 0.5], [0.5, 0.6, 0.7]]),
        spread=np.full(2, 0.05),
        roughness=np.full(2, len(table.roughness) - 1),
        metallic=np.zeros(2),
    )
    noise = Noise(0.1, np.ones(len(rows.point)))
    empty = RowLikelihood.at(Mixer(blank), noise, materials, np.zeros((3, POINTS), int))
    U, W = empty.predict(even())
    shown = materials.color[region][rows.point] * U + W
    data = replace(blank, observed=shown * np.exp(0.1 * numpy_rng(3).normal(size=shown.shape)))
    return RowLikelihood.at(Mixer(data), noise, materials, np.zeros((3, POINTS), int))


def even() -> np.ndarray:
    """A light (M, 3) that is the same all round."""
    return np.ones((128, 3))


def on_a_ground(rows: RowLikelihood) -> RowLikelihood:
    """The same rows on something that shines on them and on the nodes."""
    transport, rng = rows.data.transport, numpy_rng(4)
    grounded = object.__new__(Transport)
    grounded.__dict__.update(transport.__dict__)
    grounded.ground = "there is one"
    grounded.ground_light = rng.uniform(0.1, 0.5, transport.ground_light.shape)
    given = rng.uniform(0, 0.2, (len(rows.data.observed), 3))
    wider = lambda matrix: np.hstack([matrix.toarray(), given])
    seen = replace(
        rows.matrices, off_U=wider(rows.matrices.off_U), off_W=wider(rows.matrices.off_W)
    )
    return replace(rows, data=replace(rows.data, transport=grounded), matrices=seen)


@pytest.mark.parametrize("ground", [False, True])
@pytest.mark.parametrize("gain", GAINS)
def test_lit_rows_are_those_of_other_lights_and_colours(in_bowl, ground, gain):
    """At other levels and colours, light between parts and a ground's light included."""
    rows = on_a_ground(in_bowl) if ground else in_bowl
    color = rows.materials.color * numpy_rng(5).uniform(0.5, 1.2, (2, 3))
    seen = rows.lit(even()).seen(color, gain)
    expected = rows.recolored(color).predict(even() * gain)
    for of_lobe, other in zip(seen, expected):
        np.testing.assert_allclose(of_lobe, other, rtol=1e-5, atol=1e-6)


def test_light_off_metal_stays_as_it_is(in_bowl):
    """Metal is no diffuse emitter, so that its colour's part in the others' light is held."""
    metal = replace(in_bowl.materials, metallic=np.array([0.0, 1.0]))
    rows = RowLikelihood.at(Mixer(in_bowl.data), in_bowl.noise, metal, in_bowl.offsets)
    lit, one, color = rows.lit(even()), np.ones(3), metal.color
    brighter = lambda region: color * np.where(np.arange(2) == region, 1.2, 1.0)[:, None]
    assert not np.allclose(lit.seen(brighter(0), one)[0], lit.seen(color, one)[0], rtol=1e-4)
    for seen, before in zip(lit.seen(brighter(1), one), lit.seen(color, one)):
        np.testing.assert_array_equal(seen, before)


def over_a_grid(rows: RowLikelihood, centre: float, weight: float = 1.0) -> tuple[float, float]:
    """Mean and deviation of a shift of the light's log scale against all colours, by sums over a
    grid whose likelihood, to the power of `weight`, is made anew for every light.
    """

    def log_density(s: float) -> float:
        moved = rows.recolored(rows.materials.color * np.exp(-s))
        prior = log_prior(moved.materials, rows.data.lobes.roughness)
        scale = 0.5 * ((s - centre) / SCALE_PRIOR) ** 2
        return weight * moved.under(even() * np.exp(s)).value() + prior - scale

    grid = np.linspace(-0.25, 2.0, 451)
    density = np.array([log_density(s) for s in grid])
    share = np.exp(density - density.max())
    share /= share.sum()
    mean = share @ grid
    return float(mean), float(np.sqrt(share @ (grid - mean) ** 2))


def test_level_is_drawn_from_its_posterior(in_bowl):
    """Where channels do not shift, all colours go with the scale. Without the light between parts
    the photos of so matt a thing would hardly tell of its level.
    """
    centre = 0.5
    stay = lambda shift: 0.0 if not shift.any() else -np.inf
    mean, deviation = over_a_grid(in_bowl, centre)

    def moved(rows: RowLikelihood, scale: float, steps: int, rng) -> tuple[RowLikelihood, float]:
        light = even() * np.exp(scale)
        materials, scale, _ = draw_gauge(rows, light, scale, centre, stay, steps, rng)
        return rows.recolored(materials.color), scale

    rows, scale, rng, drawn = in_bowl, 0.0, numpy_rng(6), []
    for _ in range(400):
        rows, scale = moved(rows, scale, 20, rng)
        drawn.append(scale)
    assert abs(np.mean(drawn[20:]) - mean) < 0.5 * deviation, (np.mean(drawn[20:]), mean, deviation)
    assert 0.6 < np.std(drawn[20:]) / deviation < 1.6


class EvenLight:
    """A decoder whose light is the same all round whatever the code."""

    def light(self, code: None, log_scale: float) -> np.ndarray:
        return even() * np.exp(log_scale)


def state_of(rows: RowLikelihood, error: float) -> State:
    """Under `even`, with rows of this relative error."""
    steps = np.full(len(rows.materials), 0.05)
    noise = replace(rows.noise, scale=error)
    return State(None, 0.0, rows.materials, rows.offsets, noise, steps, steps)


def test_level_is_freer_where_photos_are_explained_badly(in_bowl, monkeypatch):
    """Twice the error up to which photos count in full: w is 1 / 32. Draws are independent, so that
    the mean of 80 is within .11 deviations, and held here to four times that."""
    monkeypatch.setattr(free_level, "SHIFTS", 81)
    centre, error = 0.5, 2 * free_level.ERROR
    state = state_of(in_bowl, error)
    weight = free_level.weight_of_photos(error)
    assert weight == pytest.approx(1 / 32)
    rows = replace(in_bowl, noise=state.noise)
    mean, deviation = over_a_grid(rows, centre, weight)
    assert deviation > 1.5 * over_a_grid(rows, centre)[1]

    kernel = free_level.free_level(Mixer(in_bowl.data), EvenLight(), centre)
    rng, drawn = Randomness(numpy_rng(7), None), []
    for _ in range(80):
        moved, shift = kernel(rng, state)
        assert moved.log_scale == shift
        np.testing.assert_allclose(moved.materials.color * np.exp(shift), state.materials.color)
        drawn.append(shift)
    assert abs(np.mean(drawn) - mean) < 0.45 * deviation, (np.mean(drawn), mean, deviation)
    assert 0.65 < np.std(drawn) / deviation < 1.45


@pytest.mark.parametrize("share", [0.2, 1.0])
def test_nothing_is_drawn_where_photos_are_explained_well(in_bowl, share):
    state = state_of(in_bowl, share * free_level.ERROR)
    kernel = free_level.free_level(Mixer(in_bowl.data), EvenLight(), 0.5)
    rng = Randomness(numpy_rng(8), None)
    assert kernel(rng, state) == (state, 0.0)
    assert rng.numpy.random() == numpy_rng(8).random()
