"""Moves of the light's level against the base colours, and what tells of it."""

from dataclasses import replace

import numpy as np
import pytest

from pipeline.posterior.split_gibbs.likelihood import Mixer, RowLikelihood
from pipeline.posterior.split_gibbs.lobes import LobeTable
from pipeline.posterior.split_gibbs.material_moves import SCALE_PRIOR, draw_gauge
from pipeline.posterior.split_gibbs.material_prior import log_prior
from pipeline.posterior.split_gibbs.row_model import RowData
from pipeline.posterior.split_gibbs.state import Noise, RegionMaterials
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


def test_level_is_drawn_from_its_posterior(in_bowl):
    """Where channels do not shift, all colours go with the scale: mean and deviation against sums
    over a grid, whose likelihood is made anew for every light. Without the light between parts the
    photos of so matt a thing would hardly tell of its level.
    """
    color, centre = in_bowl.materials.color, 0.5
    stay = lambda shift: 0.0 if not shift.any() else -np.inf

    def log_density(s: float) -> float:
        rows = in_bowl.recolored(color * np.exp(-s))
        prior = log_prior(rows.materials, in_bowl.data.lobes.roughness)
        return rows.value(even() * np.exp(s)) + prior - 0.5 * ((s - centre) / SCALE_PRIOR) ** 2

    grid = np.linspace(-0.25, 1.0, 251)
    density = np.array([log_density(s) for s in grid])
    weight = np.exp(density - density.max())
    weight /= weight.sum()
    mean = weight @ grid
    deviation = np.sqrt(weight @ (grid - mean) ** 2)

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
