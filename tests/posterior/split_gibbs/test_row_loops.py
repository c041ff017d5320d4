"""Compiled loops over rows against the formulas they stand for."""

import numpy as np
import torch

from pipeline.posterior.split_gibbs.lobes import mix
from pipeline.posterior.split_gibbs.row_loops import (
    mix_into,
    seen_rows,
    sums_by_point,
    whitened_into,
)
from tests.seeds import numpy_rng

BOUNDS = np.array([0, 3, 4, 9])
POINT = np.repeat([0, 1, 2], np.diff(BOUNDS))
ROWS = len(POINT)


def test_rows_between_two_lobes_are_mixed():
    """All kinds of metallic, rows that are not asked for left as they are."""
    rng = numpy_rng(0)
    low, high = rng.random((2, 4, ROWS, 11), np.float32)
    way, metallic = rng.random(ROWS, np.float32), np.float32([0, 0.5, 1, 0, 1, 0.5, 0, 1, 0.5])
    index = np.array([1, 2, 5, 6])
    U, W = (np.full((ROWS, 11), 7, np.float32) for _ in range(2))
    mix_into(low, high, way[index], metallic[index], index, U, W)

    lobes = low + way[:, None] * (high - low)
    expected = mix(lobes, metallic[:, None])
    for found, of_all in zip((U, W), expected):
        np.testing.assert_allclose(found[index], of_all[index], rtol=1e-5, atol=1e-6)
        assert (np.delete(found, index, 0) == 7).all()


def test_whitened_rows():
    """Against the matrix I - shrink u u' of every point."""
    rng = numpy_rng(1)
    U, W = rng.random((2, ROWS, 5), np.float32)
    color, scale, unit = rng.random((3, ROWS), np.float32)
    shrink = rng.random(3, np.float32)
    out = np.empty((ROWS, 5), np.float32)
    whitened_into(U, W, color, scale, unit, shrink, BOUNDS, out)

    x = scale[:, None] * (color[:, None] * U + W)
    for p, (first, last) in enumerate(zip(BOUNDS, BOUNDS[1:])):
        u = unit[first:last, None]
        expected = (np.eye(last - first) - shrink[p] * u @ u.T) @ x[first:last]
        np.testing.assert_allclose(out[first:last], expected, rtol=1e-5, atol=1e-6)


def test_rows_show_the_lobe_of_their_point():
    rng = numpy_rng(2)
    seen = rng.random((6, 4, ROWS, 3))
    step, metallic = np.array([5, 0, 2]), np.array([0.0, 1.0, 0.5])
    found = seen_rows(seen, step, metallic, BOUNDS)
    lobes = seen[step[POINT], :, np.arange(ROWS)].transpose(1, 0, 2)
    for mine, expected in zip(found, mix(lobes, metallic[POINT][:, None])):
        np.testing.assert_allclose(mine, expected)


def test_sums_count_saturated_rows_that_are_darker():
    """Point by point in plain array arithmetic; the middle point's only row is saturated."""
    rng = numpy_rng(3)
    U, W, observed, precision = rng.random((4, ROWS, 3))
    clipped = rng.random((ROWS, 3)) < 0.4
    clipped[3] = True
    color, variance, weight = rng.random((3, 3)), 0.1 * rng.random((3, 3)), rng.random(3)
    found = sums_by_point(U, W, observed, clipped, precision, color, variance, weight, BOUNDS)

    rest = observed - color[POINT] * U - W
    w = precision * weight[POINT][:, None]
    total = lambda rows: np.add.reduceat(rows, BOUNDS[:-1], axis=0)
    free = np.where(clipped, 0, w)
    q, g = total(free * U**2), total(free * U * rest)
    likely = color + variance * g / (1 + variance * q)
    counted = np.where(clipped & (likely[POINT] * U + W >= observed), 0, w)
    of_counted = [total(counted * x) for x in (U**2, U * rest, rest**2)]
    np.testing.assert_allclose(found, [*of_counted, total(w * U**2)])
    assert not np.allclose(found[0], q) and not np.allclose(found[0], found[3])


def test_loops_take_what_torch_holds():
    """Views of tensors, as the sampler passes them."""
    U = torch.ones(ROWS, 4)
    out = torch.empty(3, ROWS, 4)
    ones = np.ones(ROWS, np.float32)
    whitened_into(U.numpy(), U.numpy(), ones, ones, 0 * ones, ones[:3], BOUNDS, out[1].numpy())
    assert (out[1] == 2).all()
