"""The likelihood as a function of codes: its expansions are its derivatives; levels and pools."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from pipeline.posterior.split_gibbs.light_codes import (
    CodeLikelihood,
    Decoder,
    Modes,
    ModeUnknowns,
    PixelUnknowns,
)
from pipeline.posterior.split_gibbs.light_moves import scale_of_one
from pipeline.posterior.split_gibbs.pooling import pooled
from pipeline.posterior.split_gibbs.setup import first_state
from pipeline.prior.gaussian import GaussianPrior, translated
from pipeline.prior.value_code import Code, scale_of
from tests.seeds import torch_rng


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
def likelihood(request, rows) -> CodeLikelihood:
    """Lights of 16 rows before an operator that resolves 8."""
    prior = smooth_prior(16, Code(-0.4, 0.7))
    if request.param == "pixels":
        unknowns = PixelUnknowns(16 * 32, 0.3)
    else:
        unknowns = ModeUnknowns.seen(Modes(prior, prior, 30, 8), prior.flat_mean, 0.7)
    return CodeLikelihood(rows, Decoder.onto(prior, 8), unknowns, 0.2)


def unknowns_at(likelihood, noise, size: float) -> torch.Tensor:
    """z of random light and the rows' colours."""
    unknowns = likelihood.unknowns
    modes = isinstance(unknowns, ModeUnknowns)
    shape = (1, unknowns.size) if modes else (3, unknowns.pixels)
    code = size * torch.randn(shape, generator=noise)
    return unknowns.join(code, likelihood.rows.materials.color)


def colours_held(likelihood, step: torch.Tensor) -> torch.Tensor:
    """A step of z without its colours."""
    step = step.clone()
    likelihood.unknowns.numbers(step)[:] = 0
    return step


def test_expansion_is_the_derivative(likelihood):
    """Whitened predictions moved by a small step against J E d; colours held, their columns have
    their own test.
    """
    noise = torch_rng(0)
    z = unknowns_at(likelihood, noise, 0.3)
    step = colours_held(likelihood, 1e-2 * torch.randn(z.shape, generator=noise))
    J, _, fold = likelihood.expansion(z)
    T = likelihood.at(z).under.expansion()[0]
    moved = likelihood.at(z + step).under.light - likelihood.at(z - step).under.light
    expected = torch.einsum("cnm,cm->cn", T, torch.from_numpy(moved.T / 2).float()).reshape(-1)
    found = torch.cat([j @ d for j, d in zip(J, fold.down(step))])
    assert float((found - expected).norm() / expected.norm()) < 0.02


def test_colour_columns_are_the_derivative(likelihood):
    """Log-likelihood's slope in a region's log colour against finite differences, spread held near
    nothing.
    """
    spread = np.full_like(likelihood.rows.materials.spread, 1e-4)
    materials = replace(likelihood.rows.materials, spread=spread)
    known = replace(likelihood, rows=replace(likelihood.rows, materials=materials))
    z = unknowns_at(known, torch_rng(0), 0.0)
    J, r, _ = known.expansion(z)
    slope = float(J[-1, :, -1] @ r[-1])

    def value(e):
        moved = z.clone()
        moved[-1, -1] += e
        return known.at(moved).under.value()

    numeric = (value(1e-2) - value(-1e-2)) / 2e-2
    assert abs(numeric - slope) < 0.05 * abs(slope) + 0.5


def test_value_counts_the_prior_of_the_colours(likelihood):
    """Against the rows' value and the prior of the materials with its change of variables, by
    finite differences of the colours in z.
    """
    from pipeline.posterior.split_gibbs.material_prior import log_prior

    unknowns = likelihood.unknowns
    z = unknowns_at(likelihood, torch_rng(0), 0.3)
    numbers = unknowns.numbers(z)

    def log_density(of_z):
        here = likelihood.at(of_z).under
        rows = here.rows
        moved = of_z.clone()
        unknowns.numbers(moved)[:] += 1e-3
        log_slope = np.log(np.log(unknowns.colors(moved) / unknowns.colors(of_z)) / 1e-3).sum()
        prior = log_prior(rows.materials, rows.data.lobes.roughness)
        return here.value() + prior + log_slope

    other = z.clone()
    unknowns.numbers(other)[:] = numbers - 0.05
    reference = lambda of_z: 0.5 * float(unknowns.numbers(of_z).square().sum()) / unknowns.width**2
    found = (likelihood.value(z) - reference(z)) - (likelihood.value(other) - reference(other))
    assert abs(found - (log_density(z) - log_density(other))) < 0.01 * abs(found) + 0.02


def test_coefficients_undo_the_code():
    """Also where the modes belong to a prior of fewer rows and another spread."""
    gaussian, prior = smooth_prior(8, Code(0.3, 1.2)), smooth_prior(16, Code(-0.4, 0.7))
    unknowns = ModeUnknowns.seen(Modes(gaussian, prior, 30, 8), prior.flat_mean, 0.7)
    c = torch.randn(1, 30, generator=torch_rng(0))
    assert torch.allclose(unknowns.nearest(unknowns.code(c)), c, atol=1e-4)


def test_translated_code_is_the_same_radiance():
    a, b = smooth_prior(8, Code(-0.4, 0.7)), smooth_prior(16, Code(0.3, 1.2))
    code = a.sample(1, torch_rng(0))
    fine = b.decode(translated(code, a, b))[0]
    assert torch.allclose(fine[:, ::2, 1::2], a.decode(code)[0], rtol=1e-4)


@pytest.mark.parametrize("is_split", [False, True])
def test_a_codes_level_goes_to_the_scale(rows, is_split):
    """The radiance stays, that of both codes; the code, or its twin, has scale one."""
    prior = smooth_prior(16, Code(-0.4, 0.7))
    noise = torch_rng(0)
    code, twin = (0.7 + 0.3 * torch.randn(3, 16 * 32, generator=noise) for _ in range(2))
    state = state_of(rows, code, twin if is_split else None)
    radiance = lambda of, s: Decoder.onto(prior, 8).radiance(of, s.log_scale)

    new, over = scale_of_one(prior)(None, state)
    assert abs(new.log_scale - state.log_scale) > 0.1 and over != 0
    assert torch.allclose(radiance(new.code, new), radiance(code, state), rtol=1e-4)
    whole = new.code
    if is_split:
        whole = new.prior_code
        assert torch.allclose(radiance(whole, new), radiance(twin, state), rtol=1e-4)
    alone = prior.decode(whole.reshape(1, 3, 16, 32))[0]
    assert abs(scale_of(alone.permute(1, 2, 0).numpy()) - 1) < 1e-3


def state_of(rows, code, twin):
    """A state of these rows' materials with a code, split or not."""
    from types import SimpleNamespace

    gaussian = SimpleNamespace(flat_mean=code)
    model = SimpleNamespace(gaussian=gaussian, log_scale_centre=0.3, data=rows.data)
    return replace(first_state(model, rows.materials), prior_code=twin)


def test_pooled_operators_see_a_blocky_light_as_before():
    """A light of 4 rows, every pixel as a block of 4 x 4, through an operator of 16 rows."""
    noise = torch_rng(0)
    T, light = torch.randn(2, 5, 16 * 32, generator=noise), torch.randn(4 * 8, 3, generator=noise)
    fine = light.reshape(4, 8, 3).repeat_interleave(4, 0).repeat_interleave(4, 1).reshape(-1, 3)
    assert torch.allclose(pooled(T, 4) @ light, T @ fine, atol=1e-4)


def test_residual_is_that_of_the_expansion(likelihood):
    z = unknowns_at(likelihood, torch_rng(0), 0.3)
    assert torch.allclose(likelihood.residual(z), likelihood.expansion(z)[1], atol=1e-3)


def test_adjoint_is_that_of_the_expansion(likelihood):
    noise = torch_rng(0)
    z = unknowns_at(likelihood, noise, 0.3)
    J, r, fold = likelihood.expansion(z)
    w = torch.randn(r.shape, generator=noise)
    expected = fold.up(torch.einsum("cnk,cn->ck", J, w))
    found = likelihood.adjoint(z, w)
    assert float((found - expected).norm() / expected.norm()) < 1e-4
