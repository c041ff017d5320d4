"""Prior of the regions' materials, up to constants: what the world's surfaces are like.

Things are metal or not, and one body is mostly one kind. Either kind has base colours and
roughnesses of its own (widths after the measured materials of physicallybased.info, CC0): metals
are bright, grey to warm, and seldom rough; dielectrics are anything from soot to snow, of any hue.
An object is dark or bright, grey or tinted as a whole too. Independent colours would make the
common brightness and tint, which the light trades with, the surer the more regions there are.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy.special import gammaln, logsumexp

from pipeline.posterior.problem import ALBEDO_MAX
from pipeline.posterior.split_gibbs.lobes import METALLIC, LobeTable, metallic_step
from pipeline.posterior.split_gibbs.state import RegionMaterials
from pipeline.render.tint import TINTS, tint_of

# how often a surface is of each of lobes.METALLIC
KIND_SHARE = np.array([0.8, 0.2])
# of a Dirichlet distribution about these shares, from which every body draws its own: a region is
# of another kind than one before it about half as often as by the shares alone
BODY = 1.0

# added to base colours before their log is taken: below it all is black
BLACK = 0.01
# metals whose brightest channel is below it fall off with this width of its log: what reflects less
# is a dielectric's highlight (a metal of base colour .04 looks like a black dielectric)
DARKEST_METAL, FALL = 0.07, 0.02

# mean and width of log base colour, mean of channels
DIELECTRIC, METAL = (np.log(0.3), 0.8), (np.log(0.6), 0.35)
# mean and width along TINTS: gold and copper are the most saturated metals
DIELECTRIC_TINT = np.array([0.15, 0.0]), np.array([0.5, 0.3])
METAL_TINT = np.array([0.1, 0.0]), np.array([0.3, 0.1])
# no bare metal is beyond gold, copper or zinc: tints fall off with this width
METAL_TINTS, DYED = (np.array([-0.3, -0.3]), np.array([0.9, 0.3])), 0.15
# but coated ones are of any tint, candy paint or anodised: one of the 32 measured metals. Their
# density beside that of bare ones, whose tints are spread a tenth as wide
COATED = 0.005
# share of the variances that all regions of an object have in common
COMMON = 0.5
# degrees of freedom of Student's t: black paint, dyes and tarnish are far out
TAIL = 3.0
# mean and width of log roughness
DIELECTRIC_ROUGHNESS, METAL_ROUGHNESS = (np.log(0.5), 0.9), (np.log(0.33), 0.5)
# mean and width of the log of the colours' spread within a region; and the largest spread
SPREAD_PRIOR, SPREAD_MAX = (np.log(0.3), 0.7), 3


def joint_tail(square: float, total: np.ndarray, count: int, freedom: int) -> float:
    """Log of Student's t of `count` standardised rows of which `freedom` columns are independent,
    from their sum of squares and their sums by column; rows correlate by COMMON.
    """
    common = COMMON / (1 + (count - 1) * COMMON) * float(total @ total)
    apart = (square - common) / (1 - COMMON)
    return -0.5 * (TAIL + freedom * count) * float(np.log1p(apart / TAIL))


def joint_parts(color: np.ndarray, metallic: np.ndarray) -> np.ndarray:
    """What `log_joint_of` needs of every region's colour (R, 3) and metallic (R,), (R, 8):
    standardised brightness, its square, log widths, the tint's sum of squares, the tint (2), and
    which kind it is (2).
    """
    log_color, m = np.log(color + BLACK), metallic[:, None]
    centre, width = ((1 - metallic) * a + metallic * b for a, b in zip(DIELECTRIC, METAL))
    bright = (log_color.mean(1) - centre) / width
    middle, reach = ((1 - m) * a + m * b for a, b in zip(DIELECTRIC_TINT, METAL_TINT))
    tint = (log_color @ TINTS.T - middle) / reach
    widths = np.log(width) + np.log(reach).sum(1)
    kinds = np.eye(len(METALLIC))[metallic_step(metallic)]
    return np.column_stack([bright, bright**2, widths, (tint**2).sum(1), tint, kinds])


def log_joint_of(total: np.ndarray, count: int) -> float:
    """`log_joint_prior` from the sum (8,) of `count` regions' `joint_parts`."""
    brightness = joint_tail(total[1], total[:1], count, 1)
    tint = joint_tail(total[3], total[4:6], count, 2)
    kinds = gammaln(BODY * KIND_SHARE + total[6:]).sum()
    return brightness - float(total[2]) + tint + float(kinds)


def log_joint_prior(color: np.ndarray, metallic: np.ndarray) -> float:
    """Of all regions' kinds, and of their colours (R, 3) given their metallic (R,), together.

    Kinds follow a Dirichlet-multinomial distribution, so that the odds of one kind for a whole body
    do not depend on how many regions it was cut into.
    """
    return log_joint_of(joint_parts(color, metallic).sum(0), len(metallic))


@lru_cache(maxsize=8)
def log_roughness(roughness: tuple[float, ...]) -> np.ndarray:
    """Log-probability of every roughness step at every value of METALLIC, (2, steps)."""
    m = METALLIC[:, None]
    centre, width = ((1 - m) * a + m * b for a, b in zip(DIELECTRIC_ROUGHNESS, METAL_ROUGHNESS))
    value = -0.5 * ((np.log(roughness) - centre) / width) ** 2
    return value - logsumexp(value, 1, keepdims=True)


def unlike_metal(color: np.ndarray) -> np.ndarray:
    """What speaks against colours (R, 3) as metals beside Student's t, (R,): too dark, or dyed, of
    which a coating may be the cause.
    """
    darker = np.minimum(np.log(color.max(1) / DARKEST_METAL), 0) / FALL
    tint = tint_of(color + BLACK)
    dyed = (tint - np.clip(tint, *METAL_TINTS)) / DYED
    bare = np.exp(-0.5 * (dyed**2).sum(1))
    return 0.5 * darker**2 - np.log(COATED + (1 - COATED) * bare)


def log_own_prior(materials: RegionMaterials, roughness: tuple[float, ...]) -> np.ndarray:
    """Of every region's spread of colour and of its roughness, `roughness` being the value of every
    step, with the bounds of base colours (R,); -inf where a value is impossible.
    """
    mean, width = SPREAD_PRIOR
    out = -0.5 * ((np.log(materials.spread) - mean) / width) ** 2
    of_metallic = log_roughness(roughness)[metallic_step(materials.metallic)]
    out = out + of_metallic[np.arange(len(materials)), materials.roughness]
    # density by log colour of what has a density by log (colour + BLACK)
    out = out + np.log(materials.color / (materials.color + BLACK)).sum(1)
    out = out - materials.metallic * unlike_metal(materials.color)
    impossible = (materials.color >= ALBEDO_MAX).any(1) | (materials.spread > SPREAD_MAX)
    return np.where(impossible, -np.inf, out)


def log_alone(materials: RegionMaterials, lobes: LobeTable) -> np.ndarray:
    """`log_own_prior` (R,), -inf where a region is more metallic than its roughness can be."""
    own = log_own_prior(materials, lobes.roughness)
    return np.where(materials.metallic > lobes.most_metallic[materials.roughness], -np.inf, own)


def log_prior(materials: RegionMaterials, roughness: tuple[float, ...]) -> float:
    """Of all materials; `roughness`: value of every step."""
    together = log_joint_prior(materials.color, materials.metallic)
    return together + float(log_own_prior(materials, roughness).sum())
