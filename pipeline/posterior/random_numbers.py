"""Random numbers of a sample."""

from __future__ import annotations

import numpy as np
import torch


def generators(seed: int) -> tuple[np.random.Generator, torch.Generator]:
    """Random numbers of sample `seed`, its own and no other sample's: numpy's and torch's."""
    rng = np.random.default_rng([0, seed])  # [7, .], [11, .], [977, .]: operator and refinement
    noise = torch.Generator().manual_seed(seed)
    return rng, noise
