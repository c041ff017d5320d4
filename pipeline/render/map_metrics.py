"""Errors of base colour, roughness and metallic at pixels where the truth is known.

Base colour is linear Rec.709 (n, 3); roughness and metallic are (n,) in [0, 1]. The pixels are
those that a view's truth shows, whatever texture they come from.
"""

from __future__ import annotations

import numpy as np


def mse(values: np.ndarray, truth: np.ndarray) -> float:
    """Mean squared error."""
    return float(((values - truth) ** 2).mean())


def scalar_aligned(color: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """`color` times the one factor that brings it nearest to `truth` in least squares: light and
    base colour trade it.
    """
    return color * ((color * truth).sum() / max((color * color).sum(), 1e-12))


def channel_aligned(color: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """As `scalar_aligned`, with a factor for each channel."""
    return color * ((color * truth).sum(0) / np.maximum((color * color).sum(0), 1e-12))


def map_errors(
    color: np.ndarray, roughness: np.ndarray, metallic: np.ndarray, truth: dict[str, np.ndarray]
) -> dict[str, float]:
    """Errors by name, of those maps that the truth has: "albedo" (n, 3), "roughness" and "metallic"
    (n,).
    """
    out = {}
    if "albedo" in truth:
        true = truth["albedo"]
        out["albedo_mse"] = mse(color, true)
        out["albedo_mse_scalar"] = mse(scalar_aligned(color, true), true)
        out["albedo_mse_channel"] = mse(channel_aligned(color, true), true)
    if "roughness" in truth:
        out["roughness_mse"] = mse(roughness, truth["roughness"])
    if "metallic" in truth:
        out["metallic_mse"] = mse(metallic, truth["metallic"])
    return out
