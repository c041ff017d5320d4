"""The normal map in the renderer: Mitsuba's `normalmap` around a material, and the shading frames
that it gives, for the transport operator.

Mitsuba's shadowing of tilted normals (Estevez et al. 2019) stays off: UsdPreviewSurface has none.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import drjit as dr
import numpy as np

from pipeline.base.runtime import mitsuba as mi
from pipeline.geometry.normal_maps import normal_map_of, read_normal_map


def _texture(path: Path) -> dict:
    return {
        "type": "bitmap",
        "raw": True,
        "wrap_mode": "clamp",
        "data": mi.TensorXf(read_normal_map(path)),
    }


def with_normal_map(material: dict, mesh: Path) -> dict:
    """Mitsuba's description of a material with the normal map that lies beside `mesh`; the material
    as it is where there is none.
    """
    path = normal_map_of(mesh)
    if path is None:
        return material
    return {
        "type": "normalmap",
        "normalmap": _texture(path),
        "use_shadowing_function": False,
        "material": material,
    }


def material_keys(keys: dict[str, str], mesh: Path) -> dict[str, str]:
    """Names of Mitsuba's parameters `keys`, by the part that they hold, for a material without a
    normal map; corrected where `mesh` has one.
    """
    if normal_map_of(mesh) is None:
        return keys
    return {part: key.replace(".brdf_0.", ".brdf_0.nested_bsdf.") for part, key in keys.items()}


def shading_frames(si: Any, mesh: Path) -> np.ndarray:
    """Shading frames (n, 3, 3) of surface interactions on `mesh`, their rows s, t and the normal in
    the world frame; tilted by the normal map where there is one.

    As in Mitsuba, a mapped normal that would turn away from the incident direction is tilted to the
    opposite side.
    """
    axes = (si.sh_frame.s, si.sh_frame.t, si.sh_frame.n)
    frame = np.stack([np.array(axis).T for axis in axes], 1)
    path = normal_map_of(mesh)
    if path is None:
        return frame

    local = mi.load_dict(_texture(path)).eval_3(si) * 2 - 1
    away = si.wi.z * dr.dot(si.wi, local) <= 0
    normal = dr.normalize(dr.select(away, mi.Vector3f(-local.x, -local.y, local.z), local))
    along = dr.normalize(mi.Vector3f(1, 0, 0) - normal * normal.x)
    tilted = np.stack([np.array(axis).T for axis in (along, dr.cross(normal, along), normal)], 1)
    return tilted @ frame
