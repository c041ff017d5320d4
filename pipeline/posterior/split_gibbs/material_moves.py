"""Markov-chain moves of the region materials and of the light's scale, the light's pattern held
(likelihood.py's letters).

Given the light, the photos of one region say nothing of another (light off the object is held
during a block), so all of them propose at once; they accept one after the other, for the prior
joins their colours. Metropolis-Hastings throughout: Theta and the scale are drawn, not optimised.
"""

from __future__ import annotations

import numpy as np
from scipy.special import logsumexp

from pipeline.posterior.problem import ALBEDO_MAX
from pipeline.posterior.split_gibbs.likelihood import (
    BETWEEN,
    METALLIC,
    Photos,
    Theta,
    metallic_step,
    mix,
)

METALLIC_PRIOR = np.log(
    np.array([8, 4, 2, 1, 0.7, 0.5, 0.5, 0.5, 0.7, 1, 2, 4, 4]) / 28.9
)  # things are metal or not
DIELECTRIC, METAL = (
    (np.log(0.3), 0.7),
    (np.log(0.6), 0.35),
)  # mean and width of log base colour, mean of channels; between them by metallic
CHROMA = 0.35  # width of log base colour between channels
COMMON = 0.5  # share of both variances that all regions of an object have in common
TAIL = 3.0  # degrees of freedom of Student's t: black paint and dyes are far out
TAU_PRIOR = (np.log(0.3), 0.7)
OFFSETS = (
    BETWEEN * np.arange(-3, 4),
    np.array([-9, -6, -4, -2, 0, 2, 4, 6, 9]),
)  # of a point from its region: roughness levels, steps of METALLIC
WIDTHS = np.array(
    [0.0, 0.7, 1.5, 3.0]
)  # of the discrete normal that offsets come from, in units of UNITS
UNITS = BETWEEN, 1
WIDTH_PRIOR = np.log(
    [0.5, 0.2, 0.2, 0.1]
)  # a region is of one material unless its points say otherwise
SCALE_PRIOR = 1.5  # deviation of the log light scale about the level that fits a grey object


def joint_tail(square: float, total: np.ndarray, count: int, freedom: int) -> float:
    """Log of Student's t of `count` standardised rows of which `freedom` columns are independent,
    from their sum of squares and their sums by column; rows correlate by COMMON.
    """
    apart = (square - COMMON / (1 + (count - 1) * COMMON) * float(total @ total)) / (1 - COMMON)
    return -0.5 * (TAIL + freedom * count) * float(np.log1p(apart / TAIL))


def colour_parts(mu: np.ndarray, m: np.ndarray) -> np.ndarray:
    """What `log_colour_of` needs of every region's colour (R, 3) and metallic (R,): standardised
    brightness, its square, log width, the chroma's sum of squares, and chroma (R, 7).
    """
    log_mu = np.log(mu)
    mean = log_mu.mean(1)
    centre, width = ((1 - m) * a + m * b for a, b in zip(DIELECTRIC, METAL))
    bright, chroma = (mean - centre) / width, (log_mu - mean[:, None]) / CHROMA
    return np.column_stack([bright, bright**2, np.log(width), (chroma**2).sum(1), chroma])


def log_colour_of(total: np.ndarray, count: int) -> float:
    """`log_colour_prior` from the sum (7,) of `count` regions' `colour_parts`."""
    return (
        joint_tail(total[1], total[:1], count, 1)
        - float(total[2])
        + joint_tail(total[3], total[4:], count, 2)
    )


def log_colour_prior(mu: np.ndarray, m: np.ndarray) -> float:
    """Of all regions' colours (R, 3) given their metallic (R,) together, up to a constant: an
    object is dark or bright, grey or tinted, as a whole too. Independent colours would make the
    common brightness and tint, which the light trades with, the surer the more regions there are.
    """
    return log_colour_of(colour_parts(mu, m).sum(0), len(m))


def log_own_prior(theta: Theta) -> np.ndarray:
    """Of every region's spread of colour and metallic (R,), up to a constant; -inf where a value is
    impossible.
    """
    out = -0.5 * ((np.log(theta.tau) - TAU_PRIOR[0]) / TAU_PRIOR[1]) ** 2
    out = out + METALLIC_PRIOR[metallic_step(theta.m)]
    return np.where((theta.mu >= ALBEDO_MAX).any(1) | (theta.tau > 3), -np.inf, out)


def log_prior(theta: Theta) -> float:
    """Of all materials, up to a constant."""
    return log_colour_prior(theta.mu, theta.m) + float(log_own_prior(theta).sum())


def propose_spread(theta: Theta, levels: int, rng: np.random.Generator, width: np.ndarray) -> Theta:
    """Symmetric proposal for every region's spread of base colour."""
    new = theta.copy()
    new.tau = theta.tau * np.exp(width * rng.normal(size=len(width)) * 1.5)
    return new


def propose_colour(theta: Theta, levels: int, rng: np.random.Generator, width: np.ndarray) -> Theta:
    """Symmetric proposal for every region's mean colour, in its log."""
    new, regions = theta.copy(), len(theta.m)
    common = rng.normal(size=(regions, 1)) * (rng.random((regions, 1)) < 0.5)
    new.mu = theta.mu * np.exp(width[:, None] * (common + 0.5 * rng.normal(size=(regions, 3))))
    return new


def propose(theta: Theta, levels: int, rng: np.random.Generator, width: np.ndarray) -> Theta:
    """Symmetric proposal for every region: mean colour always, roughness and metallic half of the
    time each.
    """
    new, regions = propose_colour(theta, levels, rng, width), len(theta.m)
    step = np.where(
        rng.random(regions) < 0.2,
        rng.integers(-levels, levels + 1, regions),
        rng.integers(-BETWEEN, BETWEEN + 1, regions),
    )
    new.level = np.where(rng.random(regions) < 0.5, theta.level + step, theta.level)
    jump = np.where(
        rng.random(regions) < 0.2, rng.integers(-12, 13, regions), rng.integers(-1, 2, regions)
    )
    at = metallic_step(theta.m)
    at = np.where(rng.random(regions) < 0.5, at + jump, at)
    inside = (new.level >= 0) & (new.level < levels) & (at >= 0) & (at < len(METALLIC))
    new.level, new.m = (
        np.where(inside, new.level, theta.level),
        np.where(inside, METALLIC[at % len(METALLIC)], theta.m),
    )
    return new


def rows_of(lobes: np.ndarray, photos: Photos, theta: Theta) -> tuple[np.ndarray, np.ndarray]:
    """U, W (n, 3) from the lobes under the light (levels, 4, n, 3)."""
    level, m = (v[photos.rows.point] for v in photos.point_materials(theta))
    return mix(lobes[level, :, np.arange(lobes.shape[2])].transpose(1, 0, 2), m[:, None])


def draw_regions(
    photos: Photos,
    lobes: np.ndarray,
    theta: Theta,
    steps: int,
    rng,
    width: np.ndarray,
    proposal=propose,
) -> Theta:
    """`steps` Metropolis-Hastings steps of every region. `width` (R,) adapts towards 30 %
    acceptance, in place.
    """
    likelihood = lambda t: np.bincount(
        photos.region, photos.point_values(*rows_of(lobes, photos, t), t), len(t.m)
    )
    total = lambda t: np.where(
        t.m > photos.lobes.most_metallic[t.level], -np.inf, likelihood(t) + log_own_prior(t)
    )
    now = total(theta)
    for _ in range(steps):
        new = proposal(theta, len(lobes), rng, width)
        then = total(new)
        yes = accepted(theta, new, then - now, rng)
        mixed = lambda a, b: np.where(yes.reshape((-1,) + (1,) * (a.ndim - 1)), a, b)
        theta, now = (
            Theta(*(mixed(a, b) for a, b in zip(vars(new).values(), vars(theta).values()))),
            np.where(yes, then, now),
        )
        width *= np.exp(0.05 * (yes - 0.3))
        np.clip(width, 0.003, 0.5, out=width)
    return theta


def draw_offsets(photos: Photos, lobes: np.ndarray, theta: Theta, rng) -> None:
    """How far every point's roughness level and metallic lie from its region's, in place: discrete
    normals of a width that each region draws for itself, 0 among them, with its points' offsets
    summed out.
    """
    for kind, steps in enumerate(OFFSETS):
        table = []
        for step in steps:
            photos.offset[kind] = step
            table.append(photos.point_values(*rows_of(lobes, photos, theta), theta))
        table, prior = np.stack(table, 1), log_offset(steps / UNITS[kind])[:, None]
        for r in range(len(theta.m)):
            mine = np.flatnonzero(photos.region == r)
            values = table[mine][None] + prior  # (widths, points, steps)
            width = categorical(logsumexp(values, 2).sum(1)[None] + WIDTH_PRIOR, rng)[0]
            photos.offset[kind, mine] = steps[categorical(values[width], rng)]


def log_offset(steps: np.ndarray) -> np.ndarray:
    """Log-probability of every offset (widths, steps)."""
    with np.errstate(divide="ignore"):
        value = np.where(steps == 0, 0.0, -0.5 * (steps / np.maximum(WIDTHS[:, None], 1e-9)) ** 2)
    return value - logsumexp(value, 1, keepdims=True)


def categorical(log_odds: np.ndarray, rng) -> np.ndarray:
    """An index per row of log odds (n, k)."""
    return (log_odds + rng.gumbel(size=log_odds.shape)).argmax(1)


def accepted(theta: Theta, new: Theta, gain: np.ndarray, rng) -> np.ndarray:
    """Which regions take their new materials, one after the other; gain (R,): what speaks for it
    beside the prior of the colours.
    """
    yes, old = np.zeros(len(gain), bool), colour_parts(theta.mu, theta.m)
    change, total = colour_parts(new.mu, new.m) - old, old.sum(0)
    now = log_colour_of(total, len(gain))
    for r, level in enumerate(np.log(rng.random(len(gain)))):
        then = log_colour_of(total + change[r], len(gain))
        yes[r] = level < gain[r] + then - now
        if yes[r]:
            total, now = total + change[r], then
    return yes


def draw_gauge(
    photos: Photos, U, W, theta: Theta, log_scale: float, centre: float, pull, steps: int, rng
) -> tuple[Theta, float, np.ndarray]:
    """Moves along what the photos hardly tell: light brighter, base colours darker; the same per
    channel.

    `pull(shift (3,))` is the log-density of adding `shift` to the light's log radiance per channel.
    Returns the new Theta, log scale and shift.
    """
    shift = np.zeros(3)

    def value(t, log_s, d):
        gain = np.exp(log_s - log_scale + d)
        return (
            photos.point_values(U * gain, W * gain, t).sum()
            + log_prior(t)
            + pull(d)
            - 0.5 * ((log_s - centre) / SCALE_PRIOR) ** 2
        )

    now, log_s = value(theta, log_scale, shift), log_scale
    for k in range(steps):
        step = rng.normal() * 10 ** rng.uniform(-2.5, -0.3)
        new, new_s, new_shift = theta.copy(), log_s, shift.copy()
        if k % 2:
            new_s = log_s + step
            new.mu = theta.mu * np.exp(-step)
        elif k % 4 == 0:
            c = int(rng.integers(3))
            new_shift[c] += step
            new.mu[:, c] = theta.mu[:, c] * np.exp(-step)
        else:  # scale against the code's own mean: no row changes
            new_s, new_shift = log_s + step, shift - step
        then = value(new, new_s, new_shift)
        if np.log(rng.random()) < then - now:
            theta, log_s, shift, now = new, new_s, new_shift, then
    return theta, log_s, shift
