"""The rows' errors: their density, draws of them, and what they have in common."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import integrate, stats

from pipeline.posterior.problem import ALBEDO_MAX, SHADE
from pipeline.posterior.split_gibbs.noise import (
    NU,
    channel_effect,
    draw_noise,
    log_noise,
    neighbour_effect,
)
from pipeline.posterior.split_gibbs.row_model import RowModel
from pipeline.posterior.split_gibbs.state import Noise
from pipeline.render.rows import Rows
from tests.seeds import numpy_rng

CHANCE = 1e-4


class Residuals(RowModel):
    """Rows of which only the squared relative residuals (n, 3) are given."""

    def __init__(self, relative, explained, clipped, scale=1.0, effect=1.0):
        data = type("Data", (), {"unbounded": ~clipped})
        super().__init__(data, Noise(scale, np.ones(len(relative)), effect))
        object.__setattr__(self, "found", (np.where(explained, 0, relative), explained))

    def misfit(self, U, W, colors):
        return self.found


def test_noise_density_is_students_t():
    """Of three channels with one lambda, against scipy; an explained saturated row says nothing, an
    unexplained one less than nothing.
    """
    relative = numpy_rng(0).normal(size=(50, 3)) ** 2
    none = np.zeros((50, 3), bool)

    def density(scale, explained, clipped):
        return log_noise(Residuals(relative, explained, clipped, scale), None, None, None)

    def students_t(scale):
        t = stats.multivariate_t(np.zeros(3), scale**2 * np.eye(3), df=NU)
        return t.logpdf(np.sqrt(relative)).sum()

    difference = density(0.5, none, none) - density(2.0, none, none)
    assert np.isclose(difference, students_t(0.5) - students_t(2.0))
    first = np.repeat(np.arange(50)[:, None] == 0, 3, 1)
    assert density(0.01, none, first) < density(0.01, first, first)


def uniform_p(values: np.ndarray) -> float:
    """p-value of Kolmogorov and Smirnov's test that values are uniform on [0, 1]; no seed in ten
    thousand of a right draw is below CHANCE.
    """
    return float(stats.kstest(np.ravel(values), "uniform").pvalue)


def test_colours_are_drawn_from_their_conditional(rows, light):
    """Every point's colour through the cumulated density of N(a; mu, v) N(y; a U + W, D kappa) on
    [0, ALBEDO_MAX], summed over a grid: uniform over all points and draws.
    """
    rng, (U, W) = numpy_rng(0), rows.predict(light)
    data, noise, materials = rows.data, rows.noise, rows.materials
    draws = np.stack([rows.model.draw_colors(U, W, materials, rng) for _ in range(100)])
    assert draws.min() >= 0 and draws.max() <= ALBEDO_MAX
    uniform = np.empty_like(draws)
    for p, c in np.ndindex(draws.shape[1:]):
        k, r = data.rows.point == p, data.region[p]
        a = np.linspace(0, ALBEDO_MAX, 4001)
        mu, observed = materials.color[r, c], data.observed[k, c]
        error = (noise.scale * (observed + SHADE)) ** 2 / noise.weight[k]
        D = noise.design_effect * error
        e = observed - a[:, None] * U[k, c] - W[k, c]
        log = -0.5 * ((e**2 / D).sum(1) + ((a - mu) / (materials.spread[r] * mu)) ** 2)
        below = integrate.cumulative_trapezoid(np.exp(log - log.max()), a, initial=0)
        uniform[:, p, c] = np.interp(draws[:, p, c], a, below / below[-1])
    assert uniform_p(uniform) > CHANCE


@pytest.mark.parametrize("kappa", [1.0, 2.5])
def test_noise_is_drawn_from_its_conditionals(kappa):
    """lambda_i ~ Gamma((NU + channels that count) / 2, (NU + sum of their squares / eta^2) / 2),
    then eta^2 of the values that are not saturated ~ inverse gamma, its prior's shape 1 and scale
    1e-4: both through their distribution functions, uniform over 4000 draws.
    """
    rng, eta = numpy_rng(0), 0.02
    relative = eta**2 * rng.chisquare(1, size=(5, 3))
    clipped = np.zeros((5, 3), bool)
    clipped[2, 0] = clipped[3:] = True
    free = clipped & np.array([False, True, True])  # explained in two channels
    free[4] = True
    model = Residuals(relative, free, clipped, eta, kappa)
    draws = [draw_noise(model, None, None, None, rng) for _ in range(4000)]
    assert all(drawn.design_effect == kappa for drawn in draws) and model.noise.scale == eta
    etas = np.array([drawn.scale for drawn in draws])
    weights = np.array([drawn.weight for drawn in draws])

    counted = np.where(free, 0, relative)
    shape, rate = (NU + (~free).sum(1)) / 2, (NU + counted.sum(1) / eta**2) / 2
    uniform = stats.gamma.cdf(weights, shape, scale=1 / rate)
    assert min(uniform_p(row) for row in uniform.T) > CHANCE / 5

    square = (weights @ np.where(clipped, 0, relative).sum(1)) / kappa
    law = stats.invgamma(8 / (2 * kappa) + 1, scale=square / 2 + 1e-4)
    assert uniform_p(law.cdf(etas**2)) > CHANCE


def test_drawn_colours_and_noise_recover_the_truth(rows, light):
    """Rows made from known colours and Student's t noise: the truth lies among the draws of colours
    and noise in turn, as far from their mean as they spread: to four standard errors, of the spread
    of 120 numbers 4 / 240^1/2.
    """
    rng, (U, W) = numpy_rng(0), rows.predict(light)
    data, materials = rows.data, rows.materials
    spread = materials.spread[data.region, None]
    truth = materials.color[data.region] * (1 + spread * rng.normal(size=(40, 3)))
    truth = np.clip(truth, 0.02, 0.9 * ALBEDO_MAX)
    clean = truth[data.rows.point] * U + W
    weight = rng.gamma(NU / 2, 2 / NU, size=(len(clean), 1))
    error = 0.05 * rng.normal(size=clean.shape) / np.sqrt(weight)
    observed = (clean + SHADE * error) / (1 - error)

    noise, made = Noise(0.3, np.ones(len(clean))), replace(data, observed=observed)
    colors, etas = [], []
    for _ in range(120):
        model = RowModel(made, noise)
        colors.append(model.draw_colors(U, W, materials, rng))
        noise = draw_noise(model, U, W, colors[-1], rng)
        etas.append(noise.scale)
    colors, etas = np.array(colors[20:]), np.array(etas[20:])
    assert abs(((truth - colors.mean(0)) / colors.std(0)).std() - 1) < 4 / np.sqrt(2 * truth.size)
    assert np.median(np.abs(colors.mean(0) / truth - 1)) < 0.06
    assert abs(etas.mean() - 0.05) < 4 * etas.std() and etas.std() < 0.1 * etas.mean()


def test_design_effect_sees_correlation():
    """Independent residuals count fully; residuals shared by neighbours count once."""
    rng = numpy_rng(0)
    position = np.concatenate([rng.uniform(0, 1, (400, 2)), np.zeros((400, 1))], 1)
    rows, view = Rows(np.arange(400), np.arange(400)), np.zeros(400, int)
    alone = neighbour_effect(rows, position, view, rng.normal(size=400))
    smooth = np.sin(7 * position[:, 0]) + np.cos(5 * position[:, 1])
    assert alone < 1.5 and neighbour_effect(rows, position, view, smooth) > 8
    white = rng.normal(size=(3000, 3))
    assert channel_effect(white) < 1.1 and channel_effect(white[:, :1] + 0.1 * white) > 2.8
