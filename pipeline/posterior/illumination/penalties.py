"""Penalties on a light, functions of radiance (h, 2h, 3) over its mean; torch, differentiable.

All are means over the sphere, by solid angle, so that they do not depend on the light's size.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch

from pipeline.render.envmap import solid_angles

Penalty = Callable[[torch.Tensor], torch.Tensor]
ROUNDED = 1e-3  # below which an absolute value is rounded off, so that it has a slope


def _weights(light: torch.Tensor) -> torch.Tensor:
    h, w = light.shape[:2]
    return torch.from_numpy(solid_angles(h, w) / (4 * np.pi)).float()


def _size(difference: torch.Tensor) -> torch.Tensor:
    """Absolute value with a rounded tip (Charbonnier et al. 1994)."""
    return torch.sqrt(difference**2 + ROUNDED**2) - ROUNDED


def global_norm(light: torch.Tensor) -> torch.Tensor:
    """Mean square of the radiance: a light shall be no brighter than it must."""
    return ((light**2).mean(-1) * _weights(light)).sum()


def total_variation(light: torch.Tensor) -> torch.Tensor:
    """Mean over the sphere of |dL / d latitude| + |dL / d longitude| / cos(latitude), per radian: a
    light shall be smooth. Wraps around in longitude; Rudin, Osher and Fatemi 1992 on the sphere.
    """
    h, w = light.shape[:2]
    pixel = np.pi / h
    latitude = np.pi * (0.5 - (np.arange(h) + 0.5) / h)
    ring = torch.from_numpy(np.cos(latitude)).float()[:, None]

    along = _size((light.roll(-1, 1) - light) / (pixel * ring[..., None])).mean(-1)
    down = _size((light[1:] - light[:-1]) / pixel).mean(-1)
    weight = _weights(light)
    between = 0.5 * (weight[1:] + weight[:-1])
    return (along * weight).sum() + (down * between).sum()


def chromaticity(light: torch.Tensor) -> torch.Tensor:
    """Mean distance of the channels from their mean: a light shall be white (Munkberg et al. 2022,
    their light regularisation).
    """
    grey = light.mean(-1, keepdim=True)
    return (_size(light - grey).mean(-1) * _weights(light)).sum()


PENALTIES: dict[str, Penalty] = {
    "global_norm": global_norm,
    "total_variation": total_variation,
    "chromaticity": chromaticity,
}
