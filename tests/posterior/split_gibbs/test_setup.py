"""What a draw begins with: weights of blocks."""

import numpy as np

from pipeline.posterior.split_gibbs.setup import BLOCKS, block_weights
from tests.seeds import numpy_rng


def test_block_weights_are_even_in_the_mean_and_uneven_between_blocks():
    rng, position = numpy_rng(1), numpy_rng(2).normal(size=(300, 3))
    weights = np.array([block_weights(position, rng) for _ in range(200)])
    assert np.allclose(weights.mean(1), 1) and all(len(np.unique(w)) == BLOCKS for w in weights)
    assert np.abs(weights.mean(0) - 1).max() < 0.5 and 0.5 < weights.std(1).mean() < 1.3
