"""Markov-chain moves of the materials, the noise and the light's scale, the light's pattern held.

Given the light, the rows of one region say nothing of another (light off the object is held during
a block), so all of them propose at once; they accept one after the other, for the prior joins their
colours. Metropolis-Hastings and exact conditionals throughout: all of it is drawn, not optimised.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import torch

from pipeline.posterior.split_gibbs.coherence import FAVOUR, OFFSETS, draw_labels
from pipeline.posterior.split_gibbs.kind_moves import jump_kinds, label_odds
from pipeline.posterior.split_gibbs.light_codes import Decoder
from pipeline.posterior.split_gibbs.likelihood import LitRows, Mixer, RowLikelihood, seen_by
from pipeline.posterior.split_gibbs.lobes import BETWEEN, METALLIC, metallic_step
from pipeline.posterior.split_gibbs.material_prior import log_alone, log_prior
from pipeline.posterior.split_gibbs.metropolis import accepted
from pipeline.posterior.split_gibbs.noise import draw_noise
from pipeline.posterior.split_gibbs.normal_spread import draw_normal_spread
from pipeline.posterior.split_gibbs.row_model import RowModel
from pipeline.posterior.split_gibbs.state import Kernel, Noise, Randomness, RegionMaterials, State

# deviation of the log light scale about the scale that fits a grey object
SCALE_PRIOR = 1.5
GAUGE_STEPS = 60
# sweeps over the points' labels in a draw of their offsets
LABEL_SWEEPS = 3
# jumps of every region per draw of the materials
JUMPS = 12
# acceptance that step sizes adapt towards, how fast, and their bounds
ACCEPTANCE, ADAPTATION, STEP_BOUNDS = 0.3, 0.05, (0.003, 0.5)

Proposal = Callable[[RegionMaterials, int, np.random.Generator, np.ndarray], RegionMaterials]


def propose_spread(
    materials: RegionMaterials, roughnesses: int, rng: np.random.Generator, step: np.ndarray
) -> RegionMaterials:
    """Symmetric proposal for every region's spread of base colour, in its log."""
    move = step * rng.normal(size=len(step)) * 1.5
    return replace(materials, spread=materials.spread * np.exp(move))


def propose_color(
    materials: RegionMaterials, roughnesses: int, rng: np.random.Generator, step: np.ndarray
) -> RegionMaterials:
    """Symmetric proposal for every region's mean colour, in its log."""
    regions = len(materials)
    common = rng.normal(size=(regions, 1)) * (rng.random((regions, 1)) < 0.5)
    move = step[:, None] * (common + 0.5 * rng.normal(size=(regions, 3)))
    return replace(materials, color=materials.color * np.exp(move))


def propose_all(
    materials: RegionMaterials, roughnesses: int, rng: np.random.Generator, step: np.ndarray
) -> RegionMaterials:
    """Symmetric proposal for every region: mean colour always, roughness and metallic half of the
    time each; a fifth of the roughness moves go anywhere.
    """
    new = propose_color(materials, roughnesses, rng, step)
    regions = len(materials)
    jump = np.where(
        rng.random(regions) < 0.2,
        rng.integers(-roughnesses, roughnesses + 1, regions),
        rng.integers(-BETWEEN, BETWEEN + 1, regions),
    )
    moves = rng.random(regions) < 0.5
    roughness = np.where(moves, materials.roughness + jump, materials.roughness)

    now = metallic_step(materials.metallic)
    metallic = np.where(rng.random(regions) < 0.5, now + rng.integers(-1, 2, regions), now)

    inside = (roughness >= 0) & (roughness < roughnesses)
    inside = inside & (metallic >= 0) & (metallic < len(METALLIC))
    return replace(
        new,
        roughness=np.where(inside, roughness, materials.roughness),
        metallic=np.where(inside, METALLIC[metallic % len(METALLIC)], materials.metallic),
    )


def region_density(
    model: RowModel, seen: np.ndarray, materials: RegionMaterials, offsets: np.ndarray
) -> np.ndarray:
    """Log-density of every region (R,): its rows given what every lobe sees of the light (steps, 4,
    n, 3), and its prior beside what joins the regions.
    """
    data = model.data
    points = model.point_values(*seen_by(data, seen, materials, offsets), materials)
    return np.bincount(data.region, points, len(materials)) + log_alone(materials, data.lobes)


def draw_regions(
    model: RowModel,
    seen: np.ndarray,
    materials: RegionMaterials,
    offsets: np.ndarray,
    steps: int,
    rng: np.random.Generator,
    step: np.ndarray,
    proposal: Proposal = propose_all,
) -> tuple[RegionMaterials, np.ndarray, np.ndarray]:
    """`steps` Metropolis-Hastings steps of every region, given what every lobe sees (steps, 4, n,
    3) of the light.

    step (R,): step sizes. Returns materials, adapted step sizes, and the share of accepted
    proposals (R,).
    """
    now = region_density(model, seen, materials, offsets)
    taken = np.zeros(len(materials))
    for _ in range(steps):
        new = proposal(materials, len(seen), rng, step)
        then = region_density(model, seen, new, offsets)
        yes = accepted(materials, new, then - now, rng)
        materials = new.where(yes, materials)
        now = np.where(yes, then, now)
        step = np.clip(step * np.exp(ADAPTATION * (yes - ACCEPTANCE)), *STEP_BOUNDS)
        taken += yes
    return materials, step, taken / max(steps, 1)


def draw_offsets(
    model: RowModel,
    seen: np.ndarray,
    materials: RegionMaterials,
    offsets: np.ndarray,
    rng: np.random.Generator,
) -> np.ndarray:
    """How every point's material lies off its region, in a copy of `offsets` (3, p): one row of
    `coherence.OFFSETS` after the other, given the labels of its neighbours.
    """
    data = model.data
    offsets = offsets.copy()
    for row, labels in enumerate(OFFSETS):
        now = np.searchsorted(labels, offsets[row])
        odds = label_odds(model, seen, materials, offsets, row)
        drawn = draw_labels(data.neighbours, odds, FAVOUR[row], now, LABEL_SWEEPS, rng)
        offsets[row] = labels[drawn]
    return offsets


def categorical(log_odds: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """An index per row of log odds (n, k)."""
    return (log_odds + rng.gumbel(size=log_odds.shape)).argmax(1)


def scale_only(shift: np.ndarray) -> float:
    """Log-density of a shift (3,) of the code's channels where the code must stay."""
    return 0.0 if not shift.any() else -np.inf


class GaugeInfo(NamedTuple):
    """accepted: moves out of GAUGE_STEPS; shift (3,): of the light's log radiance."""

    accepted: int
    shift: np.ndarray


def draw_gauge(
    rows: RowLikelihood,
    light: np.ndarray,
    log_scale: float,
    centre: float,
    pull: Callable[[np.ndarray], float],
    steps: int,
    rng: np.random.Generator,
) -> tuple[RegionMaterials, float, GaugeInfo]:
    """Moves along what the photos hardly tell: light brighter, base colours darker; the same per
    channel. What tells is what a base colour does not scale, highlights, and what it scales twice
    or more, light between parts of the object.

    light (M, 3): now; `pull(shift (3,))`: log-density of adding `shift` to the light's log radiance
    per channel; `centre`: mean of the log scale's prior. Returns materials, log scale, and the
    shift with the count of accepted moves.
    """
    lit, roughness = rows.lit(light), rows.data.lobes.roughness

    def photos_of(m: RegionMaterials, s: float, d: np.ndarray) -> float:
        return of_photos(rows, lit, light, m, np.exp(s - log_scale + d))

    def beside(m: RegionMaterials, s: float, d: np.ndarray) -> float:
        return beside_photos(m, s, centre, roughness) + pull(d)

    materials, shift, scale, taken = rows.materials, np.zeros(3), log_scale, 0
    photos, now = photos_of(materials, scale, shift), beside(materials, scale, shift)
    for k in range(steps):
        new = propose_gauge(materials, scale, shift, k, rng)
        # with colours as they are the light's brightness is too
        there = photos if new[0] is materials else photos_of(*new)
        then = beside(*new)
        if np.log(rng.random()) < there + then - photos - now:
            (materials, scale, shift), photos, now = new, there, then
            taken += 1
    return materials, scale, GaugeInfo(taken, shift)


def of_photos(
    rows: RowLikelihood,
    lit: LitRows,
    light: np.ndarray,
    materials: RegionMaterials,
    gain: np.ndarray,
) -> float:
    """Log-likelihood of the light (M, 3), under which the rows are `lit`, times `gain` (3,), at
    these materials, of which the colours alone may differ from the rows' own.
    """
    points = rows.model.point_values(*lit.seen(materials.color, gain), materials)
    return float(points.sum()) + rows.data.seen_light.value(light * gain)


def beside_photos(
    materials: RegionMaterials, log_scale: float, centre: float, roughness: tuple[float, ...]
) -> float:
    """Log prior of the materials and of the log light scale about `centre`; roughness: value of
    every step.
    """
    scale = 0.5 * ((log_scale - centre) / SCALE_PRIOR) ** 2
    return log_prior(materials, roughness) - scale


def propose_gauge(
    materials: RegionMaterials, scale: float, shift: np.ndarray, k: int, rng: np.random.Generator
) -> tuple[RegionMaterials, float, np.ndarray]:
    """The k-th move of `draw_gauge`, symmetric: log scale against all colours, one channel's shift
    against its colours, or log scale against the shift, by which no row changes.
    """
    step = rng.normal() * 10 ** rng.uniform(-2.5, -0.3)
    if k % 2:
        color = materials.color * np.exp(-step)
        return replace(materials, color=color), scale + step, shift
    if k % 4:
        return materials, scale + step, shift - step

    channel = int(rng.integers(3))
    color, moved = materials.color.copy(), shift.copy()
    moved[channel] += step
    color[:, channel] = materials.color[:, channel] * np.exp(-step)
    return replace(materials, color=color), scale, moved


def gauge_kernel(
    mixer: Mixer, decoder: Decoder, centre: float, pull_of: Callable[[State], Callable]
) -> Kernel:
    """Kernel (Step 4b, Step 5b): the light's scale, its channels' brightness and the mean colours,
    the pattern held.

    `pull_of(state)` is `draw_gauge`'s pull.
    """

    def kernel(rng: Randomness, state: State) -> tuple[State, GaugeInfo]:
        materials, log_scale, info = draw_gauge(
            RowLikelihood.of(mixer, state),
            decoder.light(state.code, state.log_scale),
            state.log_scale,
            centre,
            pull_of(state),
            GAUGE_STEPS,
            rng.numpy,
        )
        shift = (info.shift / decoder.prior.log_spread).astype(np.float32)
        code = state.code + torch.from_numpy(shift)[:, None]
        return replace(state, code=code, log_scale=log_scale, materials=materials), info

    return kernel


class MaterialInfo(NamedTuple):
    """accepted (R,): share of accepted proposals; noise: the relative error drawn."""

    accepted: np.ndarray
    noise: float


def material_kernel(
    mixer: Mixer, decoder: Decoder, steps: int, proposal: Proposal = propose_all
) -> Kernel:
    """Kernel (Step 4c, Step 5c): region materials, the points' offsets and the spread of their
    normals (with `propose_all` only), then the spread of colours and the noise given the points'
    colours.
    """

    def kernel(rng: Randomness, state: State) -> tuple[State, MaterialInfo]:
        light = decoder.light(state.code, state.log_scale)
        rows = RowLikelihood.of(mixer, state)
        model = rows.model
        seen = mixer.data.lobes.apply(light, rows.nodes(rows.irradiance(light)))

        materials, offsets = state.materials, state.offsets
        whole = proposal is propose_all
        if whole:
            materials, offsets = jump_kinds(model, seen, materials, offsets, JUMPS, rng.numpy)
        materials, color_step, taken = draw_regions(
            model, seen, materials, offsets, steps, rng.numpy, state.color_step, proposal
        )
        if whole:
            offsets = draw_offsets(model, seen, materials, offsets, rng.numpy)
            materials, offsets = draw_normal_spread(model, seen, materials, offsets, rng.numpy)

        even, few, now = model.row_by_row(), steps // 3, state.spread_step
        materials, spread_step, _ = draw_regions(
            even, seen, materials, offsets, few, rng.numpy, now, propose_spread
        )
        drawn = RowLikelihood.at(mixer, state.noise, materials, offsets)
        noise = draw_row_noise(rng, drawn, even, light)
        noise = replace(noise, design_effect=state.noise.design_effect)
        moved = replace(state, materials=materials, offsets=offsets, noise=noise)
        new = replace(moved, color_step=color_step, spread_step=spread_step)
        return new, MaterialInfo(taken, noise.scale)

    return kernel


def draw_row_noise(
    rng: Randomness, rows: RowLikelihood, even: RowModel, light: np.ndarray
) -> Noise:
    """The rows' errors under a light, given colours drawn for the points; `even`: the rows' model
    in which each counts in full.
    """
    U, W = rows.predict(light)
    colors = even.draw_colors(U, W, rows.materials, rng.numpy)
    return draw_noise(even, U, W, colors, rng.numpy)
