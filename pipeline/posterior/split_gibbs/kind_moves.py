"""Jumps between kinds: a region turns from dielectric to metal, or to another roughness, whole.

By small steps no chain comes from one kind to the other, for halfway lies what the world has not
got. A jump changes metallic, roughness and base colour together: the colour is drawn about the one
with which the new material sends to the cameras what the photos show in the mean. The densities of
that draw, there and back, enter the acceptance (Hastings 1970).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pipeline.posterior.problem import ALBEDO_MAX
from pipeline.posterior.split_gibbs.coherence import (
    ALONE,
    FAVOUR,
    OFFSETS,
    draw_in_order,
    log_field,
    log_in_order,
)
from pipeline.posterior.split_gibbs.likelihood import seen_by
from pipeline.posterior.split_gibbs.lobes import METALLIC, metallic_step
from pipeline.posterior.split_gibbs.material_prior import log_alone
from pipeline.posterior.split_gibbs.metropolis import accepted
from pipeline.posterior.split_gibbs.row_model import RowData, RowModel
from pipeline.posterior.split_gibbs.state import RegionMaterials

# rows of offsets: two of `coherence.OFFSETS`, and the spread of normals
ROUGHNESS, KIND, SPREAD = 0, 1, 2
# of all jumps: those to the other kind, and those to any other roughness
TO_OTHER_KIND, TO_ANY_ROUGHNESS = 0.5, 0.8
# log colours are Student's t about the guess: degrees of freedom; width, and what is added to it
# over the guess, for photos hardly tell one black from another
FREEDOM, WIDTH, OF_BLACK = 3.0, 0.1, 0.005
# a guess is no darker
DARKEST = 0.01


def label_odds(
    model: RowModel, seen: np.ndarray, materials: RegionMaterials, offsets: np.ndarray, row: int
) -> np.ndarray:
    """Log odds (p, k) of every label of one row of `coherence.OFFSETS` for a point by itself, given
    its rows and the offsets' other row.
    """
    columns = []
    for label in OFFSETS[row]:
        changed = offsets.copy()
        changed[row] = label
        U, W = seen_by(model.data, seen, materials, changed)
        columns.append(model.point_values(U, W, materials))
    return np.stack(columns, 1) + ALONE[row]


def jump_kinds(
    model: RowModel,
    seen: np.ndarray,
    materials: RegionMaterials,
    offsets: np.ndarray,
    jumps: int,
    rng: np.random.Generator,
) -> tuple[RegionMaterials, np.ndarray]:
    """`jumps` of every region together with which of its points differ in kind, accepted or not:
    materials and offsets (3, p).

    Points that lie off their region hold it where it is: a metal badge on a plastic body would have
    to be plastic before the body can. So with a region's new material its points' labels are drawn
    anew, one after the other, and the densities of both draws count.
    """
    data = model.data
    favour, field = FAVOUR[KIND], data.neighbours
    label, odds = offsets[KIND], label_odds(model, seen, materials, offsets, KIND)
    for _ in range(jumps):
        offsets = of_kind(offsets, label)
        new, back = propose_jump(model, seen, materials, offsets, rng)
        odds_new = label_odds(model, seen, new, offsets, KIND)
        label_new = draw_in_order(field, odds_new, favour, rng)

        now, then = (
            log_field(field, o, favour, a) - log_in_order(field, o, favour, a)
            for o, a in ((odds, label), (odds_new, label_new))
        )
        gain = np.bincount(data.region, then - now, len(materials)) + back
        gain += log_alone(new, data.lobes) - log_alone(materials, data.lobes)
        yes = accepted(materials, new, gain, rng)

        materials = new.where(yes, materials)
        of_points = yes[data.region]
        label = np.where(of_points, label_new, label)
        odds = np.where(of_points[:, None], odds_new, odds)
    return materials, of_kind(offsets, label)


def of_kind(offsets: np.ndarray, label: np.ndarray) -> np.ndarray:
    """`offsets` (3, p) with other labels of kind (p,)."""
    return np.stack([offsets[ROUGHNESS], label, offsets[SPREAD]])


def propose_jump(
    model: RowModel,
    seen: np.ndarray,
    materials: RegionMaterials,
    offsets: np.ndarray,
    rng: np.random.Generator,
) -> tuple[RegionMaterials, np.ndarray]:
    """A jump of every region, and the log of the density of the way back over that of the way there
    (R,).

    seen (steps, 4, n, 3): what every lobe sees of the light.
    """
    regions = len(materials)
    step = metallic_step(materials.metallic)
    other = rng.random(regions) < TO_OTHER_KIND
    step = np.where(other, len(METALLIC) - 1 - step, step)
    anywhere = rng.random(regions) < TO_ANY_ROUGHNESS
    drawn = rng.integers(len(seen), size=regions)
    roughness = np.where(anywhere, drawn, materials.roughness)
    new = replace(materials, metallic=METALLIC[step], roughness=roughness)

    here = guessed_color(model, *seen_by(model.data, seen, materials, offsets))
    there = guessed_color(model, *seen_by(model.data, seen, new, offsets))
    color = there * np.exp(width(there) * rng.standard_t(FREEDOM, size=there.shape))
    back = log_density(materials.color, here) - log_density(color, there)
    return replace(new, color=color), back


def guessed_color(model: RowModel, U: np.ndarray, W: np.ndarray) -> np.ndarray:
    """Base colours (R, 3) that explain the regions' rows best, saturated values left out,
    U and W (n, 3) being what the lobes see; within [DARKEST, ALBEDO_MAX].
    """
    data = model.data
    weight = np.where(data.clipped, 0, model.precision * U)
    explained = region_sums(data, weight * (data.observed - W))
    best = explained / np.maximum(region_sums(data, weight * U), 1e-12)
    return np.clip(best, DARKEST, ALBEDO_MAX)


def width(guess: np.ndarray) -> np.ndarray:
    """Of log colours about a guess (R, 3)."""
    return WIDTH + OF_BLACK / guess


def log_density(color: np.ndarray, guess: np.ndarray) -> np.ndarray:
    """Of log colours (R, 3) about a guess, (R,), up to a constant."""
    scale = width(guess)
    far = np.log(color / guess) / scale
    tail = 0.5 * (FREEDOM + 1) * np.log1p(far**2 / FREEDOM)
    return -(tail + np.log(scale)).sum(1)


def region_sums(data: RowData, rows: np.ndarray) -> np.ndarray:
    """Sums (R, 3) over each region's rows (n, 3)."""
    regions = data.region.max() + 1
    return np.stack([np.bincount(data.row_region, column, regions) for column in rows.T], 1)
