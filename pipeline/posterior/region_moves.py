"""Markov-chain moves of the region materials and of the light's scale, the light's pattern held (likelihood.py's letters).

Given the light, regions do not know of each other (light off the object is held during a block), so all of them propose
and accept at once. Metropolis-Hastings throughout: Theta and the scale are drawn, not optimised.
"""

from __future__ import annotations

import numpy as np

from .likelihood import Photos, Theta, mix

METALLIC = np.array([0.0, 0.02, 0.05, 0.1, 0.2, 0.35, 0.5, 0.65, 0.8, 0.9, 0.95, 0.98, 1.0])
METALLIC_PRIOR = np.log(np.array([8, 4, 2, 1, 0.7, 0.5, 0.5, 0.5, 0.7, 1, 2, 4, 4]) / 28.9)     # things are metal or not
BRIGHTNESS_PRIOR = (np.log(0.3), 0.7)       # mean and deviation of log base colour, mean of channels
CHROMA_PRIOR, CHROMA_TAIL = 0.35, 3.0       # of log base colour between channels: width and degrees of freedom of Student's t; dyes are far out
TAU_PRIOR = (np.log(0.3), 0.7)
SCALE_PRIOR = 1.5                           # deviation of the log light scale about the level that fits a grey object


def log_prior(theta: Theta) -> np.ndarray:
    """Of every region (R,), up to a constant."""
    log_mu = np.log(theta.mu)
    mean = log_mu.mean(1)
    chroma = ((log_mu - mean[:, None]) ** 2).sum(1)
    out = -0.5 * ((mean - BRIGHTNESS_PRIOR[0]) / BRIGHTNESS_PRIOR[1]) ** 2
    out = out - 0.5 * (CHROMA_TAIL + 2) * np.log1p(chroma / (CHROMA_TAIL * CHROMA_PRIOR**2))
    out = out - 0.5 * ((np.log(theta.tau) - TAU_PRIOR[0]) / TAU_PRIOR[1]) ** 2
    out = out + METALLIC_PRIOR[np.abs(theta.m[:, None] - METALLIC).argmin(1)]
    return np.where((theta.mu > 0.98).any(1) | (theta.tau > 3), -np.inf, out)


def propose_spread(theta: Theta, levels: int, rng: np.random.Generator, width: np.ndarray) -> Theta:
    """Symmetric proposal for every region's spread of base colour."""
    new = theta.copy()
    new.tau = theta.tau * np.exp(width * rng.normal(size=len(width)) * 1.5)
    return new


def propose(theta: Theta, levels: int, rng: np.random.Generator, width: np.ndarray) -> Theta:
    """Symmetric proposal for every region: mean colour always, roughness and metallic half of the time each."""
    new, regions = theta.copy(), len(theta.m)
    common = rng.normal(size=(regions, 1)) * (rng.random((regions, 1)) < 0.5)
    new.mu = theta.mu * np.exp(width[:, None] * (common + 0.5 * rng.normal(size=(regions, 3))))
    step = np.where(rng.random(regions) < 0.2, rng.integers(-levels, levels + 1, regions), rng.integers(-1, 2, regions))
    new.level = np.where(rng.random(regions) < 0.5, theta.level + step, theta.level)
    at = np.abs(theta.m[:, None] - METALLIC).argmin(1)
    jump = np.where(rng.random(regions) < 0.2, rng.integers(-12, 13, regions), rng.integers(-1, 2, regions))
    at = np.where(rng.random(regions) < 0.5, at + jump, at)
    inside = (new.level >= 0) & (new.level < levels) & (at >= 0) & (at < len(METALLIC))
    new.level, new.m = np.where(inside, new.level, theta.level), np.where(inside, METALLIC[at % len(METALLIC)], theta.m)
    return new


def rows_of(lobes: np.ndarray, photos: Photos, theta: Theta) -> tuple[np.ndarray, np.ndarray]:
    """U, W (n, 3) from the lobes under the light (levels, 4, n, 3)."""
    rows = np.arange(lobes.shape[2])
    return mix(lobes[theta.level[photos.row_region], :, rows].transpose(1, 0, 2), theta.m[photos.row_region][:, None])


def draw_regions(photos: Photos, lobes: np.ndarray, theta: Theta, steps: int, rng, width: np.ndarray, proposal=propose) -> Theta:
    """`steps` Metropolis-Hastings steps of all regions at once. `width` (R,) adapts towards 30 % acceptance, in place."""
    total = lambda t: np.bincount(photos.region, photos.point_values(*rows_of(lobes, photos, t), t), len(t.m)) + log_prior(t)
    now = total(theta)
    for _ in range(steps):
        new = proposal(theta, len(lobes), rng, width)
        then = total(new)
        yes = np.log(rng.random(len(now))) < then - now
        mixed = lambda a, b: np.where(yes.reshape((-1,) + (1,) * (a.ndim - 1)), a, b)
        theta, now = Theta(*(mixed(a, b) for a, b in zip(vars(new).values(), vars(theta).values()))), np.where(yes, then, now)
        width *= np.exp(0.05 * (yes - 0.3))
        np.clip(width, 0.003, 0.5, out=width)
    return theta


def draw_gauge(photos: Photos, U, W, theta: Theta, log_scale: float, centre: float, pull, steps: int,
               rng) -> tuple[Theta, float, np.ndarray]:
    """Moves along what the photos hardly tell: light brighter, base colours darker; the same per channel.

    `pull(shift (3,))` is the log-density of adding `shift` to the light's log radiance per channel. Returns the new
    Theta, log scale and shift.
    """
    shift = np.zeros(3)

    def value(t, log_s, d):
        gain = np.exp(log_s - log_scale + d)
        return (photos.point_values(U * gain, W * gain, t).sum() + log_prior(t).sum() + pull(d)
                - 0.5 * ((log_s - centre) / SCALE_PRIOR) ** 2)
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
        else:                                               # scale against the code's own mean: no row changes
            new_s, new_shift = log_s + step, shift - step
        then = value(new, new_s, new_shift)
        if np.log(rng.random()) < then - now:
            theta, log_s, shift, now = new, new_s, new_shift, then
    return theta, log_s, shift
