"""Tangent-space normal maps: `normal.png` beside the mesh whose atlas it is made for.

A texel holds n / 2 + 1/2 in 16 bits a channel, n the unit normal in the frame of its point: red
along the tangent, green along the bitangent, blue along the interpolated vertex normal. Texture v
points up, so this is the OpenGL sign of green, as glTF and UsdPreviewSurface have it.

The tangent is dp/du of the texel's face, made orthogonal to the interpolated vertex normal; the
bitangent is normal x tangent. Mitsuba's `normalmap` has this frame. MikkTSpace (Blender, glTF)
averages tangents over the faces around a vertex: the same up to the atlas's distortion, a few
hundredths of a degree in the normal (docs/method.md). No chart may be mirrored: there MikkTSpace
turns the bitangent round and Mitsuba does not.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from pipeline.base.errors import InputError
from pipeline.base.files import atomic_path
from pipeline.geometry.mesh_io import Mesh, unit

FILE = "normal.png"
FULL = 65535  # largest value of a channel


def write_normal_map(path: Path, normals: np.ndarray) -> None:
    """Write unit normals (t, t, 3) in their tangent frames, row 0 = v 1."""
    values = np.round((np.clip(normals, -1, 1) * 0.5 + 0.5) * FULL).astype(np.uint16)
    with atomic_path(path) as temporary:
        options = [cv2.IMWRITE_PNG_COMPRESSION, 9]
        if not cv2.imwrite(str(temporary), values[..., ::-1], options):
            raise OSError(f"{path}: the normal map could not be written")


def read_normal_map(path: Path) -> np.ndarray:
    """The values (t, t, 3) float32 in [0, 1] as they lie in the file, n / 2 + 1/2. Raises
    InputError where it cannot be read.
    """
    values = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if values is None or values.ndim != 3 or values.dtype != np.uint16:
        raise InputError(
            "not a normal map of three 16-bit channels",
            path,
            "delete the folder that it lies in and run the atlas stage again",
        )
    return np.ascontiguousarray(values[..., ::-1], np.float32) / FULL


def face_tangents(mesh: Mesh) -> tuple[np.ndarray, np.ndarray]:
    """dp/du of every face (m, 3), not normalised, and twice its signed area in the texture (m,),
    negative where the atlas mirrors it. A face without area in the texture has a zero tangent.
    """
    assert mesh.uv is not None
    first, second, third = (mesh.vertices[mesh.faces[:, corner]] for corner in range(3))
    origin, one, other = (mesh.uv[mesh.faces[:, corner]] for corner in range(3))
    du_one, dv_one = (one - origin).T
    du_other, dv_other = (other - origin).T

    area = du_one * dv_other - dv_one * du_other
    along_u = dv_other[:, None] * (second - first) - dv_one[:, None] * (third - first)
    flat = np.abs(area) < 1e-20
    return np.where(flat[:, None], 0, along_u / np.where(flat, 1, area)[:, None]), area


def mirrored_share(mesh: Mesh) -> float:
    """Share of the atlas's covered area whose faces it shows mirrored."""
    _, area = face_tangents(mesh)
    return float(-area[area < 0].sum() / np.maximum(np.abs(area).sum(), 1e-20))


def frames_of(tangent: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Frames (k, 3, 3), their rows tangent, bitangent and normal, of dp/du (k, 3) and unit normals
    (k, 3).
    """
    along = unit(tangent - (tangent * normal).sum(1, keepdims=True) * normal)
    return np.stack([along, np.cross(normal, along), normal], 1)
