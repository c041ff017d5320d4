"""Prior of the regions' materials, up to constants.

Things are metal or not; dielectrics and metals have base colours of their own; an object is dark or
bright, grey or tinted as a whole too. Independent colours would make the common brightness and
tint, which the light trades with, the surer the more regions there are.
"""

from __future__ import annotations

import numpy as np

from pipeline.posterior.problem import ALBEDO_MAX
from pipeline.posterior.split_gibbs.lobes import metallic_step
from pipeline.posterior.split_gibbs.state import RegionMaterials

# of the values of lobes.METALLIC
METALLIC_PRIOR = np.log(np.array([8, 4, 2, 1, 0.7, 0.5, 0.5, 0.5, 0.7, 1, 2, 4, 4]) / 28.9)
# mean and width of log base colour, mean of channels; between them by metallic
DIELECTRIC, METAL = (np.log(0.3), 0.7), (np.log(0.6), 0.35)
# width of log base colour between channels
CHROMA = 0.35
# share of both variances that all regions of an object have in common
COMMON = 0.5
# degrees of freedom of Student's t: black paint and dyes are far out
TAIL = 3.0
# mean and width of the log of the colours' spread within a region; and the largest spread
SPREAD_PRIOR, SPREAD_MAX = (np.log(0.3), 0.7), 3


def joint_tail(square: float, total: np.ndarray, count: int, freedom: int) -> float:
    """Log of Student's t of `count` standardised rows of which `freedom` columns are independent,
    from their sum of squares and their sums by column; rows correlate by COMMON.
    """
    common = COMMON / (1 + (count - 1) * COMMON) * float(total @ total)
    apart = (square - common) / (1 - COMMON)
    return -0.5 * (TAIL + freedom * count) * float(np.log1p(apart / TAIL))


def color_parts(color: np.ndarray, metallic: np.ndarray) -> np.ndarray:
    """What `log_color_of` needs of every region's colour (R, 3) and metallic (R,), (R, 7):
    standardised brightness, its square, log width, the chroma's sum of squares, and chroma.
    """
    log_color = np.log(color)
    mean = log_color.mean(1)
    centre, width = ((1 - metallic) * a + metallic * b for a, b in zip(DIELECTRIC, METAL))
    bright = (mean - centre) / width
    chroma = (log_color - mean[:, None]) / CHROMA
    return np.column_stack([bright, bright**2, np.log(width), (chroma**2).sum(1), chroma])


def log_color_of(total: np.ndarray, count: int) -> float:
    """`log_color_prior` from the sum (7,) of `count` regions' `color_parts`."""
    brightness = joint_tail(total[1], total[:1], count, 1)
    tint = joint_tail(total[3], total[4:], count, 2)
    return brightness - float(total[2]) + tint


def log_color_prior(color: np.ndarray, metallic: np.ndarray) -> float:
    """Of all regions' colours (R, 3) given their metallic (R,), together."""
    return log_color_of(color_parts(color, metallic).sum(0), len(metallic))


def log_own_prior(materials: RegionMaterials) -> np.ndarray:
    """Of every region's spread of colour and metallic (R,); -inf where a value is impossible."""
    mean, width = SPREAD_PRIOR
    out = -0.5 * ((np.log(materials.spread) - mean) / width) ** 2
    out = out + METALLIC_PRIOR[metallic_step(materials.metallic)]
    impossible = (materials.color >= ALBEDO_MAX).any(1) | (materials.spread > SPREAD_MAX)
    return np.where(impossible, -np.inf, out)


def log_prior(materials: RegionMaterials) -> float:
    """Of all materials."""
    colors = log_color_prior(materials.color, materials.metallic)
    return colors + float(log_own_prior(materials).sum())
