"""What a draw begins with: weights of blocks, the sharpest lobe that normals can show."""

import numpy as np

from pipeline.posterior.split_gibbs.setup import BLOCKS, block_weights, sharpest


def test_block_weights_are_even_in_the_mean_and_uneven_between_blocks():
    rng, position = np.random.default_rng(1), np.random.default_rng(2).normal(size=(300, 3))
    weights = np.array([block_weights(position, rng) for _ in range(200)])
    assert np.allclose(weights.mean(1), 1) and all(len(np.unique(w)) == BLOCKS for w in weights)
    assert np.abs(weights.mean(0) - 1).max() < 0.5 and 0.5 < weights.std(1).mean() < 1.3


def test_normals_that_wobble_show_no_sharp_lobe():
    """alpha^2 = 2 sigma^2: exact normals set no bound, 5.5 degrees one near .34, wild ones leave
    rough lobes over.
    """
    assert sharpest(0.0) == 0 and sharpest(2.0) == 0.8
    assert abs(sharpest(np.radians(5.47)) - 0.34) < 0.01
    sigma = 0.08
    tilts = np.linalg.norm(sigma * np.random.default_rng(0).normal(size=(20000, 2)), axis=1)
    assert abs(sharpest(float(np.median(tilts))) ** 4 - 2 * sigma**2) < 0.05 * 2 * sigma**2
