"""Metropolis's rule for regions whose materials are joined by their prior only."""

from __future__ import annotations

import numpy as np

from pipeline.posterior.split_gibbs.material_prior import joint_parts, log_joint_of
from pipeline.posterior.split_gibbs.state import RegionMaterials


def accepted(
    materials: RegionMaterials, new: RegionMaterials, gain: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """Which regions take their new materials (R,), one after the other; gain (R,): what speaks for
    it beside the prior that joins the regions.
    """
    regions = len(gain)
    yes = np.zeros(regions, bool)
    old = joint_parts(materials.color, materials.metallic)
    change = joint_parts(new.color, new.metallic) - old
    total = old.sum(0)
    now = log_joint_of(total, regions)
    for r, threshold in enumerate(np.log(rng.random(regions))):
        then = log_joint_of(total + change[r], regions)
        yes[r] = threshold < gain[r] + then - now
        if yes[r]:
            total, now = total + change[r], then
    return yes
