"""The hull's field against the same in plain array arithmetic."""

import numpy as np
import pytest

from pipeline.surface.field import MAX_IGNORED, hull_field
from tests.seeds import numpy_rng

SIDE, VIEWS, TRUNCATION = 9, 8, 0.1


def expected(centres, matrices, distances, focal, tolerance):
    """Per centre (n, 3): every view's value in a table, sorted."""
    p = np.concatenate([centres, np.ones((len(centres), 1))], 1) @ matrices.transpose(0, 2, 1)
    pixel = (p[..., :2] / p[..., 2:]).astype(int)
    h, w = distances.shape[1:]
    seen = (p[..., 2] > 0) & (pixel >= 0).all(-1) & (pixel < [w, h]).all(-1)
    column, row = np.where(seen[..., None], pixel, 0).transpose(2, 0, 1)
    value = distances[np.arange(VIEWS)[:, None], row, column] * p[..., 2] / focal[:, None]
    ranked = np.sort(np.where(seen, value, np.inf), 0)
    ignored = np.minimum((tolerance * seen.sum(0)).astype(int), MAX_IGNORED)
    found = ranked[ignored, np.arange(len(centres))] / TRUNCATION
    return np.clip(np.where(2 * seen.sum(0) >= VIEWS, found, -1), -1, 1)


@pytest.mark.parametrize("tolerance", [0.0, 0.2, 0.6])
def test_the_hull_ignores_the_smallest_distances(tolerance):
    """Views around a block of cells, some of which see only a part of it; distances at random."""
    rng = numpy_rng(0)
    angle = np.linspace(0, 2 * np.pi, VIEWS, endpoint=False)
    turn = [[[np.cos(a), 0, -np.sin(a)], [0, 1, 0], [np.sin(a), 0, np.cos(a)]] for a in angle]
    to_camera = np.concatenate([turn, np.tile([[0], [0], [3.0]], (VIEWS, 1, 1))], 2)
    aside = 12.3 + 10 * rng.random(VIEWS)
    intrinsics = np.array([[[40, 0, a], [0, 40, 14.3], [0, 0, 1]] for a in aside])
    matrices = (intrinsics @ to_camera).astype(np.float32)
    distances = rng.normal(scale=6, size=(VIEWS, 28, 30)).astype(np.float32)
    focal = np.full(VIEWS, 40, np.float32)

    cell, low = 2.0 / SIDE, np.full(3, -1, np.float32)
    shape = (SIDE, SIDE, SIDE)
    found = hull_field(
        low, np.float32(cell), shape, matrices, distances, focal, np.float32(TRUNCATION), tolerance
    )
    centres = np.moveaxis(np.indices(shape), 0, -1).reshape(-1, 3) * cell - 1 + 0.5 * cell
    of_cells = expected(centres, matrices.astype(float), distances, focal, tolerance)
    # a centre on a pixel's edge may fall to either side
    assert (np.abs(found.ravel() - of_cells) < 1e-3).mean() > 0.995
    assert np.unique(found.round(3)).size > 20
