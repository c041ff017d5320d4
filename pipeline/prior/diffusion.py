"""The trained diffusion prior: weights, value code and label handling in one object."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from pipeline.base.errors import InputError, nearest
from pipeline.prior.network import LABELS, Denoiser
from pipeline.prior.value_code import Code


class DiffusionPrior:
    """Denoiser over codes of (height, 2 height) maps; see the package docstring for the
    protocol.
    """

    def __init__(self, model: Denoiser, code: Code, height: int, shares: dict[str, float]):
        self.model, self.code, self.height, self.width = (
            model.eval().requires_grad_(False),
            code,
            height,
            2 * height,
        )
        self.shares = shares  # of the classes among the measured maps trained on; {}: not known

    @classmethod
    def from_tensors(cls, tensors: dict, facts: dict) -> DiffusionPrior:
        """From what pipeline.prior.training.export wrote."""
        model = Denoiser(**facts["network"])
        model.load_state_dict(tensors)
        return cls(
            model, Code(facts["mean"], facts["std"]), facts["height"], facts.get("shares", {})
        )

    @property
    def log_spread(self) -> float:
        """Change of log radiance per unit of code."""
        return 2 * self.code.std

    def label_index(self, label: str | None) -> int:
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
        return self.model(
            x,
            torch.full((len(x),), float(sigma)),
            torch.tensor([self.label_index(v) for v in labels]),
        )

    def decode(self, x: torch.Tensor) -> torch.Tensor:
        return self.code.decode(x)

    def encode(self, radiance: np.ndarray) -> torch.Tensor:
        return self.code.encode(radiance)
