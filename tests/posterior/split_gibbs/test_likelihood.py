"""The rows' likelihood against dense linear algebra and integrals over a grid."""

from dataclasses import replace

import numpy as np
import torch
from scipy import stats

from pipeline.posterior.problem import ALBEDO_MAX, SHADE
from tests.posterior.split_gibbs.conftest import with_data
from tests.seeds import numpy_rng


def flat(rows):
    """The same rows with colours known."""
    spread = np.full_like(rows.materials.spread, 1e-6)
    return replace(rows, materials=replace(rows.materials, spread=spread))


def dense_value(rows, light) -> float:
    """log of the integral of N(a; mu, v) given a > 0 times N(y; a U + W, D kappa / weight) over a
    on [0, ALBEDO_MAX], without the noise's constants.
    """
    (U, W), total = rows.predict(light), 0.0
    data, noise, materials = rows.data, rows.noise, rows.materials
    for p in range(len(data.region)):
        k, r = data.rows.point == p, data.region[p]
        for c in range(3):
            mu, a = materials.color[r, c], np.linspace(0, ALBEDO_MAX, 8001)
            prior = stats.norm(mu, materials.spread[r] * mu)
            error = (noise.scale * (data.observed[k, c] + SHADE)) ** 2 / noise.weight[k]
            D = noise.design_effect / data.point_weight[p] * error
            e = data.observed[k, c] - a[:, None] * U[k, c] - W[k, c]
            inside = prior.logsf(0)
            log = -0.5 * (e**2 / D).sum(1) + prior.logpdf(a) - inside
            total += log.max() + np.log(np.trapezoid(np.exp(log - log.max()), a))
    return total


def test_colour_is_integrated_out_exactly(rows, light):
    value = rows.under(light).value()
    assert abs(value - dense_value(rows, light)) < 1e-6 * abs(value) + 1e-6


def test_whitened_rows_have_the_likelihoods_curvature(rows, light):
    """Without spread of colour the likelihood is quadratic in the light, and -|y - T L|^2 / 2 is
    all of it.
    """
    known = flat(rows)
    other = numpy_rng(5).uniform(0.1, 2, (128, 3))
    T, r, _ = known.under(light).expansion()

    def square(L):
        step = torch.from_numpy((L - light).T.astype(np.float32))
        return -0.5 * float((r - torch.einsum("cnm,cm->cn", T, step)).square().sum())

    change = known.under(light).value() - known.under(other).value()
    assert abs((square(light) - square(other)) - change) < 1e-3 * abs(known.under(other).value())


def test_saturated_rows_are_lower_bounds(rows, light):
    """Colours known, one channel of some rows saturated: under a light too dark it counts like any;
    under one so bright that it is explained it says nothing, nor does its slope.
    """
    plain = flat(rows)
    clipped = np.arange(rows.data.observed.size).reshape(-1, 3) % 4 == 0
    bounded = with_data(plain, clipped=clipped)
    dark, bright = 1e-3 * light, 1e3 * light
    assert np.isclose(bounded.under(dark).value(), plain.under(dark).value())
    assert torch.allclose(bounded.under(dark).residual, plain.under(dark).residual)
    assert (bounded.under(bright).residual[clipped.T] == 0).all()
    assert (bounded.under(bright).residual[~clipped.T] != 0).all()

    ones = torch.ones(clipped.T.shape)
    slope = bounded.under(bright).adjoint(ones)[0]
    only = bounded.under(bright).adjoint(ones * torch.from_numpy(~clipped.T))[0]
    assert torch.allclose(slope, only)

    clipped = np.repeat(np.arange(len(clipped))[:, None] % 3 == 0, 3, 1)
    bounded = with_data(plain, clipped=clipped)
    weight = np.where(clipped.any(1), rows.noise.weight * 2, rows.noise.weight)
    heavier = replace(bounded, noise=replace(rows.noise, weight=weight))
    assert not np.isclose(heavier.under(dark).value(), plain.under(dark).value())
    before = bounded.under(bright).value()
    assert abs(heavier.under(bright).value() - before) < 1e-3 * abs(before)  # the determinant alone
