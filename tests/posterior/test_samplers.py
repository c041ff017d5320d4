"""Every sampler on one small scene: it draws usable maps that explain the photos, from its seed
alone.
"""

import numpy as np
import pytest
import torch

from pipeline.base.config import Sample
from pipeline.posterior.samplers import SAMPLERS
from pipeline.posterior.split_gibbs.sampler import Chain
from pipeline.prior.load import load_prior

pytestmark = pytest.mark.usefixtures("one_thread")
SMALL = Sample(
    steps=8,
    pixels=400,
    spp=2,
    texture=32,
    learning_rate=0.05,
    smooth=1,
    levels=2,
    stay=1,
    points=40,
    views=3,
    light=8,
    region_steps=5,
    search_prior="gaussian_tiny",
    search_points=10,
    search_sweeps=1,
)


def error(problem, x) -> float:
    """Median relative error over the observed pixels."""
    index = np.arange(0, len(problem.observations), 4)
    problem.renderer.set(x)
    L = problem.renderer.mean_radiance(lambda rng: problem.observations.rays(index, rng), 32, 3)
    y = problem.observations.rgb[index]
    return float(np.median(np.abs(L - y) / (y + 0.1)))


def test_a_chain_goes_back_to_an_earlier_state(problem, start):
    """Turns change materials, noise and light; `resume` brings all of them back, in what the photos
    predict too.
    """
    with torch.no_grad():
        chain = Chain(problem, load_prior("prior_small"), start[0], SMALL, 0)
        theta, light = chain.theta, np.ones((2 * SMALL.light**2, 3))
        chain.photos.set(theta)
        before, state = chain.photos.value(light), chain.state()
        chain.begin(theta.made_of(0, 1.0), chain.gaussian.flat_mean)
        assert chain.photos.value(light) != before and chain.coefficients.any()
        chain.resume(state)
    assert (
        chain.photos.value(light) == before
        and not chain.coefficients.any()
        and chain.photos.eta == 0.3
    )


@pytest.mark.parametrize("name", list(SAMPLERS))
def test_sampler_explains_the_photos_from_its_seed(problem, start, name):
    """A draw in between must not matter, another seed must, and the median pixel is right to 15 %
    where steps suffice.
    """
    prior = load_prior("prior_small")
    a, b, again = (SAMPLERS[name](problem, prior, start[0], SMALL, seed)[0] for seed in (0, 1, 0))
    for field in ("light", "base_color", "roughness", "metallic"):
        values = getattr(a, field)
        assert np.isfinite(values).all() and values.min() >= 0
        assert np.array_equal(values, getattr(again, field)), field
    assert a.light.shape == (32, 64, 3) and a.base_color.max() <= 1
    assert (name == "map") == np.array_equal(a.light, b.light)
    if name in ("split_gibbs", "gaussian", "map"):  # eight guided steps are too few for the others
        assert error(problem, a) < 0.15
