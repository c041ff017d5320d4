"""The rows' errors: their density, draws of them, and what they have in common."""

from dataclasses import replace

import numpy as np
from scipy import stats

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


class Residuals(RowModel):
    """Rows of which only the squared relative residuals (n, 3) are given."""

    def __init__(self, relative, explained, clipped, scale=1.0):
        data = type("Data", (), {"clipped": clipped})
        super().__init__(data, Noise(scale, np.ones(len(relative))))
        object.__setattr__(self, "found", (np.where(explained, 0, relative), explained))

    def misfit(self, U, W, colors):
        return self.found


def test_noise_density_is_students_t():
    """Of three channels with one lambda, against scipy; an explained saturated row says nothing, an
    unexplained one less than nothing.
    """
    relative = np.random.default_rng(0).normal(size=(50, 3)) ** 2
    none, plain = np.zeros((50, 3), bool), np.zeros(50, bool)

    def density(scale, explained, clipped):
        return log_noise(Residuals(relative, explained, clipped, scale), None, None, None)

    def students_t(scale):
        t = stats.multivariate_t(np.zeros(3), scale**2 * np.eye(3), df=NU)
        return t.logpdf(np.sqrt(relative)).sum()

    difference = density(0.5, none, plain) - density(2.0, none, plain)
    assert np.isclose(difference, students_t(0.5) - students_t(2.0))
    first = np.arange(50) == 0
    assert density(0.01, none, first) < density(0.01, none | first[:, None], first)


def test_drawn_colours_and_noise_recover_the_truth(rows, light):
    """Rows made from known colours and noise: colours within error bars."""
    rng = np.random.default_rng(0)
    U, W = rows.predict(light)
    materials, data = rows.materials, rows.data
    of_point = materials.spread[data.region, None]
    truth = materials.color[data.region] * (1 + of_point * rng.normal(size=(40, 3)))
    truth = np.clip(truth, 0.02, 0.95)
    clean = truth[data.rows.point] * U + W
    observed = clean / (1 - 0.05 * np.clip(rng.normal(size=clean.shape), -3, 3))

    model = RowModel(replace(data, observed=observed), Noise(0.3, np.ones(len(clean))))
    for _ in range(30):
        colors = model.draw_colors(U, W, materials, rng)
        model = RowModel(model.data, draw_noise(model, U, W, colors, rng))
    assert np.median(np.abs(colors / truth - 1)) < 0.1
    assert 0.02 < model.noise.scale < 0.055  # t residuals with clipped normal noise


def test_design_effect_sees_correlation():
    """Independent residuals count fully; residuals shared by neighbours count once."""
    rng = np.random.default_rng(0)
    position = np.concatenate([rng.uniform(0, 1, (400, 2)), np.zeros((400, 1))], 1)
    rows, view = Rows(np.arange(400), np.arange(400)), np.zeros(400, int)
    alone = neighbour_effect(rows, position, view, rng.normal(size=400))
    smooth = np.sin(7 * position[:, 0]) + np.cos(5 * position[:, 1])
    assert alone < 1.5 and neighbour_effect(rows, position, view, smooth) > 8
    white = rng.normal(size=(3000, 3))
    assert channel_effect(white) < 1.1 and channel_effect(white[:, :1] + 0.1 * white) > 2.8
