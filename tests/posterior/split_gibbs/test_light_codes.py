"""The likelihood as a function of codes: its expansions are its derivatives, and the search finds
what made the photos.
"""

from types import SimpleNamespace

import numpy as np
import pytest
import torch

from pipeline.posterior.split_gibbs import start_search as evidence
from pipeline.posterior.split_gibbs.light_codes import ModeCode, Modes, PixelCode
from pipeline.posterior.split_gibbs.likelihood import BETWEEN, Theta
from pipeline.posterior.split_gibbs.pooling import pooled
from pipeline.posterior.split_gibbs.start_search import CANDIDATES, Search
from pipeline.posterior.split_gibbs.turns import Turns
from pipeline.prior.gaussian import GaussianPrior, translated
from pipeline.prior.value_code import Code, scale_of
from tests.render.test_transport import photos, scene, transport  # noqa: F401  (fixtures)


def smooth_prior(height: int, code: Code) -> GaussianPrior:
    """Variance falls with frequency and couples neighbouring rows."""
    rows = np.arange(height)
    near = torch.from_numpy(np.exp(-np.abs(rows[:, None] - rows) / 4)).float()
    fall = 1 / (1 + torch.arange(height + 1.0)) ** 2
    return GaussianPrior(
        torch.zeros(3, height),
        torch.stack([s * fall[:, None, None] * near for s in (2.0, 0.2, 0.1)]),
        code,
    )


@pytest.fixture(params=["pixels", "modes"])
def coded(request, photos):  # noqa: F811
    """Lights of 16 rows before an operator that resolves 8."""
    prior = smooth_prior(16, Code(-0.4, 0.7))
    if request.param == "pixels":
        return PixelCode(photos, prior, 0.2, 0.3)
    return ModeCode(photos, prior, 0.2, Modes(prior, prior, 30, 8), prior.flat_mean, 0.7)


def test_expansion_is_the_derivative(coded, photos):  # noqa: F811
    """Whitened predictions moved by a small step against J E d; colours held, their columns have
    their own test.
    """
    noise = torch.Generator().manual_seed(0)
    z = coded.join(
        0.3 * torch.randn(3 if isinstance(coded, PixelCode) else 1, coded.size, generator=noise),
        photos.theta,
    )
    step = 1e-2 * torch.randn(z.shape, generator=noise)
    step[:, coded.size :] = 0
    J, r, fold = coded.expansion(z)
    T = photos.whitened(coded.light(coded.code(z)))[0]
    moved = torch.from_numpy(
        (coded.light(coded.code(z + step)) - coded.light(coded.code(z - step))).T / 2
    ).float()
    expected = torch.einsum("cnm,cm->cn", T, moved).reshape(-1)
    found = torch.cat([j @ d for j, d in zip(J, fold.down(step))])
    assert float((found - expected).norm() / expected.norm()) < 0.02


def test_colour_columns_are_the_derivative(coded, photos):  # noqa: F811
    """Log-likelihood's slope in a region's log colour against finite differences, spread held near
    nothing.
    """
    photos.theta.tau[:] = 1e-4
    photos.set(photos.theta)
    z = coded.join(torch.zeros(3 if isinstance(coded, PixelCode) else 1, coded.size), photos.theta)
    J, r, _ = coded.expansion(z)
    colours = J.shape[2] - 1
    slope = float(J[-1, :, colours] @ r[-1])

    def likelihood(e):
        moved, theta = z.clone(), photos.theta.copy()
        moved[-1, -1] += e
        theta.mu = coded.colours(moved)
        photos.set(theta)
        return photos.value(coded.light(coded.code(moved)))

    numeric = (likelihood(1e-2) - likelihood(-1e-2)) / 2e-2
    assert abs(numeric - slope) < 0.05 * abs(slope) + 0.5


def test_coefficients_undo_the_code(photos):  # noqa: F811
    """Also where the modes belong to a prior of fewer rows and another spread."""
    gaussian, prior = smooth_prior(8, Code(0.3, 1.2)), smooth_prior(16, Code(-0.4, 0.7))
    coded = ModeCode(photos, prior, 0.2, Modes(gaussian, prior, 30, 8), prior.flat_mean, 0.7)
    c = torch.randn(1, 30, generator=torch.Generator().manual_seed(0))
    assert torch.allclose(coded.coefficients(coded.code(c)), c, atol=1e-4)


def test_translated_code_is_the_same_radiance():
    a, b = smooth_prior(8, Code(-0.4, 0.7)), smooth_prior(16, Code(0.3, 1.2))
    code = a.sample(1, torch.Generator().manual_seed(0))
    fine = b.decode(translated(code, a, b))[0]
    assert torch.allclose(fine[:, ::2, 1::2], a.decode(code)[0], rtol=1e-4)


def test_a_codes_level_goes_to_the_scale(photos):  # noqa: F811
    """The radiance stays; the code has scale one."""
    prior, settings = smooth_prior(16, Code(-0.4, 0.7)), SimpleNamespace()
    turns = Turns(photos, photos.theta, 0.3, prior, prior, settings, None, None)
    code = 0.7 + 0.3 * torch.randn(3, 16 * 32, generator=torch.Generator().manual_seed(0))
    radiance = lambda code, log_scale: (
        float(np.exp(log_scale)) * prior.decode(code.reshape(1, 3, 16, 32))[0]
    )
    new = turns.of_scale_one(prior, code)
    assert abs(turns.log_scale - 0.3) > 0.1
    assert torch.allclose(radiance(new, turns.log_scale), radiance(code, 0.3), rtol=1e-4)
    assert abs(scale_of(radiance(new, 0.0).permute(1, 2, 0).numpy()) - 1) < 1e-3


def test_pooled_operators_see_a_blocky_light_as_before():
    """A light of 4 rows, every pixel as a block of 4 x 4, through an operator of 16 rows."""
    noise = torch.Generator().manual_seed(0)
    T, light = torch.randn(2, 5, 16 * 32, generator=noise), torch.randn(4 * 8, 3, generator=noise)
    fine = light.reshape(4, 8, 3).repeat_interleave(4, 0).repeat_interleave(4, 1).reshape(-1, 3)
    assert torch.allclose(pooled(T, 4) @ light, T @ fine, atol=1e-4)


def test_residual_is_that_of_the_expansion(coded, photos):  # noqa: F811
    z = coded.join(
        0.3
        * torch.randn(
            3 if isinstance(coded, PixelCode) else 1,
            coded.size,
            generator=torch.Generator().manual_seed(0),
        ),
        photos.theta,
    )
    assert torch.allclose(coded.residual(z), coded.expansion(z)[1], atol=1e-3)


def test_adjoint_is_that_of_the_expansion(coded, photos):  # noqa: F811
    noise = torch.Generator().manual_seed(0)
    z = coded.join(
        0.3 * torch.randn(3 if isinstance(coded, PixelCode) else 1, coded.size, generator=noise),
        photos.theta,
    )
    J, r, fold = coded.expansion(z)
    w = torch.randn(r.shape, generator=noise)
    expected = fold.up(torch.einsum("cnk,cn->ck", J, w))
    assert float((coded.adjoint(z, w) - expected).norm() / expected.norm()) < 1e-4


def test_search_finds_the_material(photos, monkeypatch):  # noqa: F811
    """Photos of a shiny and a rough region under a light of the prior's own: levels within one
    traced lobe, metal told from dielectric. (With the search's usual error a grey metal is likely
    enough to be drawn for the rough one.)
    """
    monkeypatch.setattr(evidence, "ERROR", 0.03)
    prior = smooth_prior(8, Code(-0.4, 0.7))
    rng = np.random.default_rng(4)
    truth = Theta(
        np.array([[0.6, 0.5, 0.4], [0.3, 0.3, 0.35]]),
        np.full(2, 0.05),
        np.array([0, 4 * BETWEEN]),
        np.array([1.0, 0.0]),
    )
    photos.eta, photos.kappa, photos.weight = 0.03, 1.0, np.ones(len(photos.observed))
    photos.set(truth)
    B, _ = prior.modes(60)
    c = torch.randn(60, generator=torch.Generator().manual_seed(3))
    code = prior.flat_mean + torch.einsum("k,kcm->cm", c, B)
    light = prior.decode(code.reshape(1, 3, 8, 16)).reshape(3, -1).T.numpy().astype(float)
    U, W = photos.predict(light)
    colour = truth.mu[photos.region]
    photos.observed = (colour[photos.rows.point] * U + W) * (1 + 0.02 * rng.normal(size=U.shape))
    start = Theta(
        np.full((2, 3), 0.3), np.full(2, 0.3), np.array([2, 2]) * BETWEEN, np.array([0.2, 0.2])
    )
    for found, _ in Search(photos, prior, 0.0, 40, rng).run(start, 3, rng):  # from either start
        assert found.m[0] in CANDIDATES[2:] and found.m[1] in CANDIDATES[:2]
        assert np.abs(found.level - truth.level).max() <= BETWEEN
