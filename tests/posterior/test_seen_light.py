"""The light that photos look into, as data."""

import copy
from dataclasses import replace

import numpy as np
import pytest
import torch

from pipeline.base.config import Fit
from pipeline.posterior.fit import fit
from pipeline.posterior.problem import Problem
from pipeline.posterior.seen_light import SeenLight
from pipeline.posterior.split_gibbs.material_moves import draw_gauge
from pipeline.render.envmap import directions, resample_area
from pipeline.render.metrics import light_psnr
from pipeline.render.surroundings import SIGHT_ROWS, Sightings, Surroundings
from tests.posterior.split_gibbs.conftest import light, rows, with_data  # noqa: F401
from tests.render.test_transport import bowl, scene, transport  # noqa: F401  (fixtures)
from tests.seeds import numpy_rng, seeded, torch_rng


def sighted(env: np.ndarray, where: np.ndarray, clip: float = np.inf) -> Sightings:
    """What photos that clip at a level show of a light (8 or SIGHT_ROWS rows) in the cells `where`
    of the table.
    """
    table = np.repeat(np.repeat(env, SIGHT_ROWS // len(env), 0), SIGHT_ROWS // len(env), 1)
    clipped = (table >= clip).any(-1)
    shown = np.minimum(table, clip)
    return Sightings(shown, np.where(where, 0.3, np.inf), clipped & where)


@pytest.fixture
def with_sights(rows, scene):  # noqa: F811
    """The rows of the ball, with the upper half of the light seen, clipped at 4."""
    upper = directions(SIGHT_ROWS, 2 * SIGHT_ROWS)[..., 1] > 0
    return with_data(rows, sightings=sighted(scene[2], upper, 4.0))


def test_seen_rows_are_part_of_the_expansion(with_sights, rows, light):  # noqa: F811
    """The value is that of the object's rows and of the seen pixels' squares; T, r and the adjoint
    agree.
    """
    seen = with_sights.data.seen_light
    assert 0 < len(seen.pixel) < len(light) and seen.clipped.any()
    dim = 0.7 * light
    expected = rows.under(dim).value() - 0.5 * (seen.residual(dim) ** 2).sum()
    assert with_sights.under(dim).value() == pytest.approx(expected)

    T, r, V = with_sights.under(dim).expansion()
    n = len(rows.data.observed)
    assert T.shape[1] == r.shape[1] == V.shape[1] == n + len(seen.pixel)
    assert torch.equal(r, with_sights.under(dim).residual)
    assert torch.equal(T[:, :n], rows.under(dim).expansion()[0])
    for c in range(3):
        by_row = r[c, n:].numpy()
        np.testing.assert_allclose(by_row, seen.residual(dim)[:, c], rtol=1e-5)

    w = torch.randn(r.shape, generator=torch_rng(0))
    of_light, of_colors = with_sights.under(dim).adjoint(w)
    assert torch.allclose(of_light, torch.einsum("cnm,cn->cm", T, w), atol=1e-3)
    assert torch.allclose(of_colors, torch.einsum("cnr,cn->cr", V, w), atol=1e-3)


def test_saturated_sky_is_a_lower_bound(with_sights, light):  # noqa: F811
    """A lamp brighter than the photo can show says nothing more; a darker one is wrong."""
    seen = with_sights.data.seen_light
    assert seen.value(light) > -1e-12
    np.testing.assert_allclose(seen.slope(light), 0, atol=1e-12)
    lamp = seen.pixel[seen.clipped]
    darker, brighter = light.copy(), light.copy()
    darker[lamp], brighter[lamp] = 1.0, 50.0
    assert seen.value(brighter) > -1e-12
    assert seen.value(darker) < -1
    assert (seen.slope(darker)[lamp].max(-1) < 0).all()


def test_without_sightings_there_are_no_rows(rows, light):  # noqa: F811
    none = SeenLight.of(None, 8)
    assert len(none.pixel) == 0 and none.value(light) == 0
    assert rows.under(light).expansion()[0].shape[1] == len(rows.data.observed)


def test_gauge_is_bound_by_what_is_seen(rows, light):  # noqa: F811
    """A light's level wanders against the colours where a matt object shows it only, and stays
    where it is seen.
    """
    matt = replace(rows.materials, metallic=np.zeros(2), spread=np.full(2, 0.5))
    no_highlights = replace(rows.matrices, W=torch.zeros_like(rows.matrices.W))
    by_object = replace(rows, materials=matt, matrices=no_highlights)
    sights = sighted(light.reshape(8, 16, 3), np.ones((64, 128), bool))

    def level(seed: int, likelihood) -> float:
        stay = lambda shift: 0.0 if not shift.any() else -np.inf
        return draw_gauge(likelihood, light, 0.0, 0.0, stay, 200, numpy_rng(seed))[1]

    free = np.array([level(seed, by_object) for seed in range(4)])
    seen = np.array([level(seed, with_data(by_object, sightings=sights)) for seed in range(4)])
    assert np.abs(free).max() > 2 * np.abs(seen).max(), (free, seen)


def test_fit_recovers_a_light_better_that_it_sees(problem, start, toy):
    """The light of the toy scene, with the whole upper half seen."""
    truth = toy[1].light
    table = resample_area(truth, SIGHT_ROWS, 2 * SIGHT_ROWS)
    upper = directions(SIGHT_ROWS, 2 * SIGHT_ROWS)[..., 1] > 0
    observations = copy.copy(problem.observations)
    observations.surroundings = Surroundings(None, sighted(table, upper))
    seeing = Problem(observations, problem.renderer, problem.roughness_min)
    found, _ = fit(seeing, Fit(steps=40, pixels=1000, texture=32), seeded(0))
    assert light_psnr(found.light, truth) > light_psnr(start[0].light, truth) + 0.5
