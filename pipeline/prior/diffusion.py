"""The trained diffusion prior: network, value code and classes in one object."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from pipeline.base.errors import InputError, nearest
from pipeline.prior.network import Denoiser
from pipeline.prior.value_code import Code
from pipeline.prior.weight_facts import LABELS


class DiffusionPrior:
    """Denoiser over codes of (height, 2 height) maps; the protocol is that of `prior.load`."""

    def __init__(self, model: Denoiser, code: Code, height: int, shares: dict[str, float]):
        self.model = model.eval().requires_grad_(False)
        self.code = code
        self.height = height
        self.width = 2 * height
        self.shares = shares  # of the classes among the measured maps trained on; {}: not known

    @classmethod
    def from_tensors(cls, tensors: dict, facts: dict) -> DiffusionPrior:
        """From what pipeline.prior.training.export wrote."""
        model = Denoiser(**facts["network"])
        model.load_state_dict(tensors)
        code = Code(facts["mean"], facts["std"])
        return cls(model, code, facts["height"], facts.get("shares", {}))

    @property
    def log_spread(self) -> float:
        """Change of log radiance per unit of code."""
        return 2 * self.code.std

    def label_index(self, label: str | None) -> int:
        """The network's number of a class; None: the number that stands for no class. Raises
        InputError for a class that is not in LABELS.
        """
        if label is None:
            return len(LABELS)
        if label not in LABELS:
            raise InputError(
                f"the prior has no class '{label}'", "sample.label", nearest(label, LABELS)
            )
        return LABELS.index(label)

    def denoise(
        self, x: torch.Tensor, sigma: float, label: str | Sequence[str | None] | None = None
    ) -> torch.Tensor:
        """E[x_0 | x_0 + sigma n = x] for codes (n, 3, h, w), of one class or of one for each."""
        labels = [label] * len(x) if label is None or isinstance(label, str) else label
        numbers = torch.tensor([self.label_index(name) for name in labels])
        return self.model(x, torch.full((len(x),), float(sigma)), numbers)

    def decode(self, x: torch.Tensor) -> torch.Tensor:
        """Codes (n, 3, h, w) -> scale-free radiance (n, 3, h, w)."""
        return self.code.decode(x)

    def encode(self, radiance: np.ndarray) -> torch.Tensor:
        """Scale-free radiance (h, w, 3) -> codes (1, 3, h, w)."""
        return self.code.encode(radiance)
