"""Adam (Kingma and Ba 2015) by torch's own function for a step.

torch.optim.Adam does the same, bit for bit. Its class imports torch's compiler when first made,
which takes a second; fit and every refinement are processes of their own.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch.optim.adam import adam

EPSILON = 1e-8  # torch's own


class Adam:
    """Moves `values` down their `grad`, each at its rate."""

    def __init__(
        self, values: Sequence[torch.Tensor], rates: Sequence[float], betas: tuple[float, float]
    ):
        self.values = list(values)
        self.rates = list(rates)
        self.betas = betas
        self.mean = [torch.zeros_like(value) for value in self.values]
        self.square = [torch.zeros_like(value) for value in self.values]
        self.count = [torch.zeros(()) for _ in self.values]

    def set_learning_rate(self, learning_rate: float) -> None:
        """The same rate for all values."""
        self.rates = [learning_rate] * len(self.values)

    def step(self) -> None:
        """One step of those values that have a slope."""
        for k, value in enumerate(self.values):
            if value.grad is None:
                continue
            adam(
                [value],
                [value.grad],
                [self.mean[k]],
                [self.square[k]],
                [],
                [self.count[k]],
                foreach=False,
                amsgrad=False,
                beta1=self.betas[0],
                beta2=self.betas[1],
                lr=self.rates[k],
                weight_decay=0.0,
                eps=EPSILON,
                maximize=False,
            )
