"""The light that a code stands for, and derivatives on their way back from light to code.

The prior's network works on codes (1, 3, h, w), the renderer on radiance (h, w, 3). While a sampler
is at work the code may be turned by some columns (Eq. 19); the photos were taken under the light
that is not.
"""

from __future__ import annotations

import numpy as np
import torch

from pipeline.posterior.material_optimizer import MaterialOptimizer
from pipeline.prior.protocol import Prior
from pipeline.render.envmap import yaw_roll
from pipeline.render.renderer import Explanation


def decoded(prior: Prior, code: torch.Tensor, light_scale: float) -> torch.Tensor:
    """Radiance (3, h, w) of a code (1, 3, h, w), differentiable."""
    return light_scale * prior.decode(code)[0]


def as_light(radiance: torch.Tensor, columns: int = 0) -> np.ndarray:
    """Radiance (3, h, w) that is turned by `columns` as the renderer's light (h, w, 3) that is
    not.
    """
    turned = radiance.detach().numpy().transpose(1, 2, 0)
    return np.ascontiguousarray(yaw_roll(turned, -columns))


def slope_in_code(
    radiance: torch.Tensor, light_slope: np.ndarray, code: torch.Tensor, columns: int = 0
) -> torch.Tensor:
    """Derivative (1, 3, h, w) in the code of a loss whose derivative in the renderer's light (h, w,
    3) is `light_slope`: backpropagated through all that made `radiance` of `code`.
    """
    turned = yaw_roll(light_slope, columns).transpose(2, 0, 1)
    slope = torch.from_numpy(np.ascontiguousarray(turned))
    return torch.autograd.grad((radiance * slope).sum(), code)[0]


def finished_sample(
    prior: Prior, code: torch.Tensor, light_scale: float, materials: MaterialOptimizer
) -> Explanation:
    """What a sampler returns that ends with `code` (1, 3, h, w) and `materials`."""
    with torch.no_grad():
        return materials.explanation(as_light(decoded(prior, code, light_scale)))
