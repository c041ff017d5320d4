"""Jumps between kinds: a region turns from dielectric to metal, or to another roughness, whole.

By small steps no chain comes from one kind to the other, for halfway lies what the world has not
got. A jump changes metallic, roughness and base colour together, so that what the region sends to
the cameras in the mean stays as it is. The new colour is a function of the old one, and the way
back is its inverse; so the ratio of volumes enters the acceptance (Green 1995).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pipeline.posterior.split_gibbs.likelihood import seen_by
from pipeline.posterior.split_gibbs.lobes import METALLIC, metallic_step
from pipeline.posterior.split_gibbs.row_model import RowData, RowModel
from pipeline.posterior.split_gibbs.state import RegionMaterials

# of all jumps: those to the other kind, and those to any other roughness
TO_OTHER_KIND, TO_ANY_ROUGHNESS = 0.5, 0.8


def propose_jump(
    model: RowModel,
    seen: np.ndarray,
    materials: RegionMaterials,
    offsets: np.ndarray,
    rng: np.random.Generator,
) -> tuple[RegionMaterials, np.ndarray]:
    """A jump of every region, as likely from here to there as back; and the log of the volume of
    log colours there over that here (R,), -inf where no base colour keeps the mean radiance.

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

    data = model.data
    weight = model.precision * data.observed
    u, w = (region_sums(data, weight * part) for part in seen_by(data, seen, materials, offsets))
    u_new, w_new = (region_sums(data, weight * part) for part in seen_by(data, seen, new, offsets))
    color = (materials.color * u + w - w_new) / u_new
    possible = ((color > 0) & (u / u_new > 0)).all(1)
    color = np.where(possible[:, None], color, materials.color)
    volume = np.log(np.where(possible[:, None], materials.color / color * u / u_new, 1)).sum(1)
    return replace(new, color=color), np.where(possible, volume, -np.inf)


def region_sums(data: RowData, rows: np.ndarray) -> np.ndarray:
    """Sums (R, 3) over each region's rows (n, 3)."""
    regions = data.region.max() + 1
    return np.stack([np.bincount(data.row_region, column, regions) for column in rows.T], 1)
