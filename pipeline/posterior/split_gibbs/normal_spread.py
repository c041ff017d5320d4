"""How much the normals about a point spread, beyond what the mesh shows: an unknown of every point.

A mesh that is made from photos has normals in error. A sharp reflection then comes from another
part of the light than the mesh says, by chance, and over such normals it is blurred: normals that
spread by sigma per axis turn a lobe of alpha = roughness^2 into one of

    alpha'^2 = alpha^2 + 2 sigma^2        (render/principled_lobes.py, blurred_roughness)

The rows tell alpha' only. The mesh's error sigma_0, as the mesh stage estimates it, says how much
of it is the normals': sigma_p = sigma_0 RATIO^(k_p), with k_p a discrete normal of width
POINT_WIDTH about its region's k_r, and k_r one of width REGION_WIDTH about 0, for the estimate may
be off as a whole. The material's own roughness is what is exported. A given mesh has sigma_0 = 0
and no such unknown.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.special import logsumexp

from pipeline.posterior.split_gibbs.likelihood import point_materials
from pipeline.posterior.split_gibbs.lobes import NO_SPREAD, mix
from pipeline.posterior.split_gibbs.material_prior import log_alone
from pipeline.posterior.split_gibbs.row_model import RowModel
from pipeline.posterior.split_gibbs.state import RegionMaterials
from pipeline.surface.normal_error import UNSURE

# from one spread to the next, and how many lie either side of the mesh's
RATIO, EITHER_SIDE = UNSURE, 3
# widths in such steps: a point's about its region's, a region's about the mesh's
POINT_WIDTH, REGION_WIDTH = 1.0, 1.0


def spreads_about(error: float) -> np.ndarray:
    """The spreads that a point's normals may have, about an error per axis (radians); 0 alone where
    that is 0.
    """
    if error == 0:
        return NO_SPREAD
    return error * RATIO ** np.arange(-EITHER_SIDE, EITHER_SIDE + 1.0)


def log_spreads(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Log-probability of every region's index (s,), and of a point's given its region's (s, s)."""
    index = np.arange(count)
    region = -0.5 * ((index - count // 2) / REGION_WIDTH) ** 2
    point = -0.5 * ((index - index[:, None]) / POINT_WIDTH) ** 2
    normalised = lambda log: log - logsumexp(log, -1, keepdims=True)
    return normalised(region), normalised(point)


def shown_values(
    model: RowModel, seen: np.ndarray, materials: RegionMaterials, metallic: np.ndarray
) -> np.ndarray:
    """Log-likelihood of every point (p, steps) if it showed the lobe of each roughness step, its
    metallic (p,) given; -inf at steps that nothing shows.
    """
    data = model.data
    of_rows = metallic[data.rows.point][:, None]
    out = np.full((len(data.region), len(seen)), -np.inf)
    for step in np.unique(data.lobes.blurred):
        out[:, step] = model.point_values(*mix(seen[step], of_rows), materials)
    return out


def draw_normal_spread(
    model: RowModel,
    seen: np.ndarray,
    materials: RegionMaterials,
    offsets: np.ndarray,
    rng: np.random.Generator,
) -> tuple[RegionMaterials, np.ndarray]:
    """Roughness of every region together with the spread of its points' normals, an exact draw
    given all else: materials, and `offsets` (3, p) with a new last row.

    seen (steps, 4, n, 3): what every lobe sees of the light. They must move together, for a
    sharper material over wilder normals looks the same. Roughnesses at which a point's metallic
    could not stay as it is are left out.
    """
    data, lobes = model.data, model.data.lobes
    if len(lobes.spreads) == 1:
        return materials, offsets

    regions, steps = len(materials), len(lobes.roughness)
    now = point_materials(data, materials, offsets)[1]
    shown = shown_values(model, seen, materials, now)
    log_region, log_point = log_spreads(len(lobes.spreads))
    log_odds = np.empty((regions, steps, len(log_region)))
    of_points = np.empty((steps, len(now), len(log_region)))
    for step in range(steps):
        new = replace(materials, roughness=np.full(regions, step))
        roughness, metallic = point_materials(data, new, offsets)
        of_points[step] = np.take_along_axis(shown, lobes.blurred[roughness], 1)

        by_point = logsumexp(of_points[step][:, None] + log_point, 2)
        by_point = np.where((metallic == now)[:, None], by_point, -np.inf)
        rows = np.zeros((regions, len(log_region)))
        np.add.at(rows, data.region, by_point)
        log_odds[:, step] = rows + log_region + log_alone(new, lobes)[:, None]

    both = log_odds.reshape(regions, -1)
    chosen = (both + rng.gumbel(size=both.shape)).argmax(1)
    step, of_region = np.divmod(chosen, len(log_region))
    odds = of_points[step[data.region], np.arange(len(now))] + log_point[of_region[data.region]]
    spread = (odds + rng.gumbel(size=odds.shape)).argmax(1)
    return replace(materials, roughness=step), np.stack([*offsets[:2], spread])
