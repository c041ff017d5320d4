"""Where the tests' random numbers come from: generators whose seeds all move together, by
`pytest --seed-offset N`.

What a test asserts holds for every seed. So no test makes a generator of its own, and
`tests/test_seeds.py` holds every file to that.
"""

import numpy as np
import torch

offset = 0  # set by tests/conftest.py before any test is imported


def seeded(seed: int) -> int:
    """The seed that stands for `seed` in this run: of a stage, a sampler, a renderer."""
    return seed + offset


def numpy_rng(seed: int) -> np.random.Generator:
    return np.random.default_rng(seeded(seed))


def torch_rng(seed: int) -> torch.Generator:
    return torch.Generator().manual_seed(seeded(seed))
