"""Labels of points: Gibbs sweeps draw the field that is stated; it ends where the colour does."""

import itertools

import numpy as np

from pipeline.posterior.split_gibbs.coherence import FAVOUR, Neighbours, draw_labels
from tests.seeds import numpy_rng


def test_sweeps_leave_the_field_as_it_is():
    """Five points, two of them far from the others' colour: pairs of labels as often as the sum
    over all 32 states says, to five deviations of each of 40.
    """
    rng = numpy_rng(0)
    pairs, weight = (
        np.array([[0, 1], [1, 2], [2, 3], [3, 4], [0, 2]]),
        np.array([1, 0.7, 1, 0.2, 1]),
    )
    neighbours = Neighbours.joining(5, pairs, weight)
    odds = rng.normal(size=(5, 2))

    states = np.array(list(itertools.product(range(2), repeat=5)))
    alone = odds[np.arange(5), states].sum(1)
    joined = sum(w * FAVOUR[1][states[:, i], states[:, j]] for (i, j), w in zip(pairs, weight))
    chance = np.exp(alone + joined)
    chance /= chance.sum()

    label, drawn = np.zeros(5, int), []
    for _ in range(6000):
        label = draw_labels(neighbours, odds, FAVOUR[1], label, 2, rng)
        drawn.append(label)
    drawn = np.array(drawn)
    for i, j in itertools.combinations(range(5), 2):
        for a, b in itertools.product(range(2), repeat=2):
            exact = chance[(states[:, i] == a) & (states[:, j] == b)].sum()
            found = ((drawn[:, i] == a) & (drawn[:, j] == b)).mean()
            # successive draws are not independent: a third of them counts
            assert abs(found - exact) < 5 * np.sqrt(exact * (1 - exact) / 2000)


def test_neighbours_are_of_one_region_and_count_by_their_colour():
    rng = numpy_rng(1)
    position = rng.uniform(size=(200, 3))
    region = (position[:, 0] > 0.5).astype(int)
    feature = np.where(position[:, 1:2] > 0.5, 1.0, 0.0) * np.ones((1, 3))
    field = Neighbours.of(position, feature, region)

    one, column = np.nonzero(field.weight)
    other = field.index[one, column]
    assert (region[one] == region[other]).all()
    matrix = np.zeros((200, 200))
    matrix[one, other] = field.weight[one, column]
    np.testing.assert_array_equal(matrix, matrix.T)
    assert matrix.diagonal().max() == 0 and (matrix > 0).sum(1).mean() > 4
    alike = (feature[one] == feature[other]).all(1)
    weight = field.weight[one, column]
    assert (weight[alike] == 1).all() and weight[~alike].max() < 1e-6 and (~alike).sum() > 20


def test_a_patch_holds_where_single_points_do_not():
    """On a grid of one colour, points that lean alone towards another label come back to their
    neighbours', a whole patch does not.
    """
    side = 12
    at = np.stack(np.mgrid[:side, :side], -1).reshape(-1, 2)
    grid = Neighbours.of(np.pad(at, ((0, 0), (0, 1))).astype(float), 0.0 * at, np.zeros(side**2))
    patch = (at < 5).all(1)
    single = ~patch & (at % 4 == 2).all(1)
    odds = np.zeros((side**2, 2))
    odds[:, 0] = 2.0
    odds[patch | single, 1] = 4.0
    rng, label, share = numpy_rng(2), np.zeros(side**2, int), []
    for _ in range(200):
        label = draw_labels(grid, odds, FAVOUR[1], label, 1, rng)
        share.append(label == 1)
    share = np.mean(share[20:], 0)
    assert share[patch].mean() > 0.9 and share[single].mean() < 0.5
