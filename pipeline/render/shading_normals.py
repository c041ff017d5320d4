"""The normal map in the renderer: Mitsuba's `normalmap` around a material, and the shading normals
that it gives, for the transport operator.

Mitsuba's shadowing of tilted normals (Estevez et al. 2019) stays off: UsdPreviewSurface has none.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np

from pipeline.base.runtime import mitsuba as mi
from pipeline.geometry.surface import Surface


def _texture(normals: np.ndarray) -> dict:
    return {
        "type": "bitmap",
        "raw": True,
        "wrap_mode": "clamp",
        "data": mi.TensorXf(normals),
    }


def with_normal_map(material: dict, surface: Surface) -> dict:
    """Mitsuba's description of a material with the surface's normal map; the material as it is
    where there is none.
    """
    if surface.normals is None:
        return material
    return {
        "type": "normalmap",
        "normalmap": _texture(surface.normals),
        "use_shadowing_function": False,
        "material": material,
    }


def shading_normals(si: Any, surface: Surface) -> np.ndarray:
    """Shading normals (n, 3) of interactions with the surface, in the world's frame; tilted by the
    normal map where there is one.

    As in Mitsuba, a mapped normal that would turn away from the incident direction is tilted to the
    opposite side.
    """
    if surface.normals is None:
        return np.array(si.sh_frame.n).T
    local = mi.load_dict(_texture(surface.normals)).eval_3(si) * 2 - 1
    away = si.wi.z * dr.dot(si.wi, local) <= 0
    normal = dr.normalize(dr.select(away, mi.Vector3f(-local.x, -local.y, local.z), local))
    return np.array(si.sh_frame.to_world(normal)).T
