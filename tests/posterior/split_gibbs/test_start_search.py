"""The search for start materials finds what made the photos."""

from dataclasses import replace

import numpy as np
import torch

from pipeline.posterior.split_gibbs import start_search
from pipeline.posterior.split_gibbs.likelihood import Mixer, RowLikelihood
from pipeline.posterior.split_gibbs.lobes import BETWEEN
from pipeline.posterior.split_gibbs.start_search import Search
from pipeline.posterior.split_gibbs.state import Noise, RegionMaterials
from pipeline.prior.value_code import Code
from tests.posterior.split_gibbs.test_light_codes import smooth_prior


def test_search_finds_the_material(rows, monkeypatch):
    """Photos of a shiny and a rough region under a light of the prior's own: roughness within one
    traced lobe, metal told from dielectric. (With the search's usual error a grey metal is likely
    enough to be drawn for the rough one.)
    """
    monkeypatch.setattr(start_search, "ERROR", 0.03)
    prior, rng = smooth_prior(8, Code(-0.4, 0.7)), np.random.default_rng(4)
    truth = RegionMaterials(
        color=np.array([[0.6, 0.5, 0.4], [0.3, 0.3, 0.35]]),
        spread=np.full(2, 0.05),
        roughness=np.array([0, 4 * BETWEEN]),
        metallic=np.array([1.0, 0.0]),
    )
    noise = Noise(0.03, np.ones(len(rows.data.observed)))
    made = RowLikelihood.at(Mixer(rows.data), noise, truth, rows.offsets)

    B, _ = prior.modes(60)
    c = torch.randn(60, generator=torch.Generator().manual_seed(3))
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
