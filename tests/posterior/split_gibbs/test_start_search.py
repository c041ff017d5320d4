"""The search for start materials finds what made the photos."""

from dataclasses import replace

import numpy as np
import torch

from pipeline.posterior.split_gibbs import start_search
from pipeline.posterior.split_gibbs.likelihood import Mixer, RowLikelihood
from pipeline.posterior.split_gibbs.lobes import BETWEEN
from pipeline.posterior.split_gibbs.search_rows import SearchRows
from pipeline.posterior.split_gibbs.start_search import Search
from pipeline.posterior.split_gibbs.state import Noise, RegionMaterials
from pipeline.prior.value_code import Code
from tests.posterior.split_gibbs.test_light_codes import smooth_prior
from tests.seeds import numpy_rng, torch_rng


def test_search_finds_the_material(rows, monkeypatch):
    """Photos of a shiny and a rough region under a light of the prior's own: roughness within one
    traced lobe, metal told from dielectric. (With the search's usual error a grey metal is likely
    enough to be drawn for the rough one.)
    """
    monkeypatch.setattr(start_search, "ERROR", 0.03)
    prior, rng = smooth_prior(8, Code(-0.4, 0.7)), numpy_rng(4)
    truth = RegionMaterials(
        color=np.array([[0.6, 0.5, 0.4], [0.3, 0.3, 0.35]]),
        spread=np.full(2, 0.05),
        roughness=np.array([0, 4 * BETWEEN]),
        metallic=np.array([1.0, 0.0]),
    )
    noise = Noise(0.03, np.ones(len(rows.data.observed)))
    made = RowLikelihood.at(Mixer(rows.data), noise, truth, rows.offsets)

    B, _ = prior.modes(60)
    c = torch.randn(60, generator=torch_rng(3))
    code = prior.flat_mean + torch.einsum("k,kcm->cm", c, B)
    light = prior.decode(code.reshape(1, 3, 8, 16)).reshape(3, -1).T.numpy().astype(float)
    U, W = made.predict(light)
    color = truth.color[rows.data.region][rows.data.rows.point]
    observed = (color * U + W) * (1 + 0.02 * rng.normal(size=U.shape))
    data = replace(rows.data, observed=observed)

    start = RegionMaterials(
        np.full((2, 3), 0.3), np.full(2, 0.3), np.array([2, 2]) * BETWEEN, np.array([0.2, 0.2])
    )
    search = Search.over(data, prior, 0.0, 40, rng)
    free, dielectric, metal = (found for found, _ in search.run(start, 3, rng))
    assert free.metallic.tolist() == [1, 0]
    assert not dielectric.metallic.any() and metal.metallic.all()
    assert np.abs(free.roughness - truth.roughness).max() <= BETWEEN


def test_regions_looked_at_together_are_as_each_alone(rows):
    """Pieces of regions that come several times, in any order, with other materials each time."""
    prior, rng = smooth_prior(8, Code(-0.4, 0.7)), numpy_rng(5)
    saturated = rng.random(rows.data.clipped.shape) < 0.1
    data = replace(rows.data, clipped=saturated, point_weight=rng.random(len(rows.data.region)))
    search = Search.over(data, prior, 0.0, 40, rng).counting_saturated(0.3)
    at = search.linear(0.3 * torch.randn(search.unknowns.size, generator=torch_rng(7)))

    materials = RegionMaterials(
        rng.uniform(0.1, 0.9, (4, 3)),
        rng.uniform(0.1, 0.4, 4),
        np.array([0, 5, 2 * BETWEEN, 3]),
        np.array([0.0, 1.0, 1.0, 0.0]),
    )
    regions = [1, 0, 1, 1]
    together = search.pieces(materials, at, regions)
    for k, region in enumerate(regions):
        (alone,) = search.pieces(materials.of([k]), at, [region])
        assert np.isclose(together[k].value, alone.value, rtol=1e-5)
        assert np.allclose(together[k].materials.color, alone.materials.color, rtol=1e-5)
        assert np.allclose(together[k].materials.spread, alone.materials.spread, rtol=1e-4)
        assert torch.allclose(together[k].H, alone.H, rtol=1e-3, atol=1e-3 * float(alone.H.max()))
        assert torch.allclose(together[k].b, alone.b, rtol=1e-3, atol=1e-3 * float(alone.b.max()))


def test_rows_of_the_search_are_those_of_its_points(rows):
    """Every row of a region stays with its point, whatever the order."""
    data = rows.data
    some = SearchRows.over(data, 40, numpy_rng(6))
    assert (np.diff(some.data.region) >= 0).all() and (np.diff(some.data.rows.point) >= 0).all()

    twice = some.of((1, 0, 1))
    assert (twice.region[twice.rows.point] == twice.row_region).all()
    originals = dict(zip(data.rows.observation, data.rows.point))
    for part, region in enumerate((1, 0, 1)):
        point = [originals[o] for o in twice.rows.observation[twice.row_region == part]]
        assert (data.region[point] == region).all()
        mine = twice.rows.point[twice.row_region == part]
        assert len(set(zip(mine, point))) == len(set(mine)) == len(set(point))
    weights = data.point_weight[[originals[o] for o in twice.rows.observation]]
    assert (twice.point_weight[twice.rows.point] == weights).all()
