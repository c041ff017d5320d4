"""Material maps under Adam, kept within their valid ranges."""

from __future__ import annotations

import cv2
import numpy as np
import torch

from pipeline.posterior.adam import Adam
from pipeline.posterior.problem import ALBEDO_MAX
from pipeline.render.renderer import Explanation, Gradient

MAPS = ("base_color", "roughness", "metallic")
SMOOTH = 80  # roughness and metallic gradients are blurred by 1 / SMOOTH of the texture's side
Bound = float | np.ndarray  # one for the whole map, or one for every texel
BETAS = (0.9, 0.99)  # Adam's memory of slope and squared slope, in materials and light alike


class MaterialOptimizer:
    """Base colour, roughness and metallic as torch parameters (`values`, by name) under Adam, which
    fit, guided sampling and refinement move (Eqs. 15, 16 and 17). `bounds`: least and greatest
    value of each map.
    """

    def __init__(
        self,
        explanation: Explanation,
        learning_rate: float | dict[str, float],
        roughness_min: float,
        betas: tuple[float, float] = BETAS,
        blurred: bool = True,
    ):
        """learning_rate: one number, or one per name of MAPS; betas: Adam's; blurred: roughness and
        metallic move as smooth fields.
        """
        self.blurred = blurred
        self.ior = explanation.ior  # stays
        self.values = {name: torch.from_numpy(getattr(explanation, name).copy()) for name in MAPS}
        self.bounds: dict[str, tuple[Bound, Bound]] = {
            "base_color": (0.0, ALBEDO_MAX),
            "roughness": (roughness_min, 1.0),
            "metallic": (0.0, 1.0),
        }

        if not isinstance(learning_rate, dict):
            learning_rate = dict.fromkeys(MAPS, learning_rate)
        values, rates = [self.values[name] for name in MAPS], [learning_rate[n] for n in MAPS]
        self.adam = Adam(values, rates, betas)

    def step(self, gradient: Gradient) -> None:
        """One step of Adam down the gradient, then back into the valid ranges."""
        for name, value in self.values.items():
            slope: np.ndarray = np.ascontiguousarray(getattr(gradient, name), np.float32)
            if name != "base_color" and self.blurred:
                # photos say little about the fine detail of gloss: move it as a smooth field
                slope = cv2.GaussianBlur(slope, (0, 0), max(slope.shape[0] / SMOOTH, 0.5))
            value.grad = torch.from_numpy(slope)

        self.adam.step()
        for name, value in self.values.items():
            low, high = (torch.as_tensor(bound) for bound in self.bounds[name])
            value.clamp_(low, high)

    def set_learning_rate(self, learning_rate: float) -> None:
        """The same rate for all three maps."""
        self.adam.set_learning_rate(learning_rate)

    def explanation(self, light: np.ndarray) -> Explanation:
        """The maps as they are, under `light`. They share memory with the parameters: the next
        step changes them.
        """
        maps = (self.values[name].numpy() for name in MAPS)
        return Explanation(light, *maps, ior=self.ior)
