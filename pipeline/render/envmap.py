"""Lat-long environment maps: directions, solid angles, resampling, and Mitsuba's storage of them.

Frame: row 0 = +Y; u = 0.5 - lon / 2 pi with lon = atan2(x, z); v = 0.5 - lat / pi; pixel centres at
+0.5. Maps are (h, w, 3) radiance with w = 2 h, float32.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pipeline.base.errors import InputError


def direction_from_uv(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Unit vectors (..., 3) of lat-long coordinates u, v in [0, 1], broadcast against each
    other.
    """
    latitude = np.pi * (0.5 - v)
    longitude = 2 * np.pi * (0.5 - u)
    ring = np.cos(latitude)

    x = ring * np.sin(longitude)
    y = np.sin(latitude)
    z = ring * np.cos(longitude)
    return np.stack(np.broadcast_arrays(x, y, z), -1)


def directions(h: int, w: int) -> np.ndarray:
    """Unit vectors through the pixel centres, (h, w, 3)."""
    u = (np.arange(w) + 0.5) / w
    v = (np.arange(h) + 0.5) / h
    return direction_from_uv(u, v[:, None])


def uv_from_direction(direction: np.ndarray) -> np.ndarray:
    """Directions (..., 3) of any length -> (u, v) in [0, 1), (..., 2)."""
    unit = direction / np.linalg.norm(direction, axis=-1, keepdims=True)
    u = 0.5 - np.arctan2(unit[..., 0], unit[..., 2]) / (2 * np.pi)
    v = 0.5 - np.arcsin(np.clip(unit[..., 1], -1, 1)) / np.pi
    return np.stack([u % 1.0, v], -1)


def solid_angles(h: int, w: int) -> np.ndarray:
    """Solid angle of every pixel in steradians, (h, w); sums to 4 pi exactly."""
    sines = np.sin(np.pi * (0.5 - np.arange(h + 1) / h))
    per_row = (sines[:-1] - sines[1:]) * 2 * np.pi / w
    return np.broadcast_to(per_row[:, None], (h, w))


def mean_radiance(env: np.ndarray) -> np.ndarray:
    """Solid-angle mean over the sphere, per channel (3,)."""
    weights = solid_angles(*env.shape[:2])
    return (env * weights[..., None]).sum((0, 1)) / (4 * np.pi)


def _covered(source_edges: np.ndarray, target_edges: np.ndarray) -> np.ndarray:
    """Share of target interval i that source interval j covers, (targets, sources)."""
    low = np.maximum(target_edges[:-1, None], source_edges[None, :-1])
    high = np.minimum(target_edges[1:, None], source_edges[None, 1:])
    length = target_edges[1:] - target_edges[:-1]
    return np.clip(high - low, 0, None) / length[:, None]


def resample_area(env: np.ndarray, h: int, w: int) -> np.ndarray:
    """Average over solid angle to (h, w): the flux, sum of L dOmega, is kept exactly, so no sun
    loses energy.
    """
    source_h, source_w = env.shape[:2]
    # equal steps of the latitude's sine are equal solid angles
    row_edges = lambda n: 1 - np.sin(np.pi * (0.5 - np.arange(n + 1) / n))
    column_edges = lambda n: np.arange(n + 1) / n

    rows = _covered(row_edges(source_h), row_edges(h))
    columns = _covered(column_edges(source_w), column_edges(w))
    return np.einsum("ij,jkc,lk->ilc", rows, env, columns, optimize=True).astype(np.float32)


def yaw_roll(env: np.ndarray, columns: int) -> np.ndarray:
    """Turn the light about +Y by a whole number of columns (exact, invertible)."""
    return np.roll(env, columns, axis=1)


def mirror(env: np.ndarray) -> np.ndarray:
    """The light seen in a mirror (x -> -x)."""
    return env[:, ::-1]


def sh_basis(h: int, w: int) -> np.ndarray:
    """Real spherical harmonics up to order 2 at the pixel centres, (9, h, w), band by band, m =
    -l..l, Y-up.
    """
    x, y, z = np.moveaxis(directions(h, w), -1, 0)
    return np.stack(
        [
            0.282095 * np.ones_like(x),
            0.488603 * x,
            0.488603 * y,
            0.488603 * z,
            1.092548 * x * z,
            1.092548 * x * y,
            0.315392 * (3 * y * y - 1),
            1.092548 * y * z,
            0.546274 * (z * z - x * x),
        ]
    )


def sh_coefficients(env: np.ndarray, order: int = 2) -> np.ndarray:
    """Real spherical-harmonic coefficients up to `order` <= 2, ((order + 1)^2, 3), band by band, m
    = -l..l, Y-up.

    Raises ValueError for higher orders.
    """
    if order > 2:
        raise ValueError("orders above 2 are not implemented")

    basis = sh_basis(*env.shape[:2])
    weights = solid_angles(*env.shape[:2])
    project = lambda function: (env * (function * weights)[..., None]).sum((0, 1))
    return np.stack([project(function) for function in basis[: (order + 1) ** 2]])


def _twice_the_rows(env: np.ndarray) -> np.ndarray:
    """(h, w, 3) -> (2h + 1, w, 3): rows at v = r / 2h, odd ones the pixel centres, even ones
    halfway between.
    """
    out = np.empty((2 * len(env) + 1,) + env.shape[1:], env.dtype)
    out[1::2] = env
    out[2:-1:2] = 0.5 * (env[:-1] + env[1:])
    out[0] = env[0]
    out[-1] = env[-1]
    return out


def to_mitsuba(env: np.ndarray) -> np.ndarray:
    """(h, w, 3) -> (2h + 1, w + 2, 3), the tensor `data` of Mitsuba 3.9's `envmap` that looks the
    same.

    Mitsuba puts its first and last row at the poles, not half a pixel away from them as lat-long
    files do, hence the doubled rows; and it stores one column of the other side at both ends.
    """
    rows = _twice_the_rows(env)
    return np.concatenate([rows[:, -1:], rows, rows[:, :1]], 1)


def mitsuba_gradient(gradient: np.ndarray) -> np.ndarray:
    """Adjoint of `to_mitsuba`: gradient in `data` (2h + 1, w + 2, 3) -> gradient in the map (h, w,
    3).

    Mitsuba refreshes the border columns itself and folds their gradient into the interior.
    """
    interior = gradient[:, 1:-1]
    between = interior[2:-1:2]

    out = interior[1::2].copy()
    out[:-1] += 0.5 * between
    out[1:] += 0.5 * between
    out[0] += interior[0]
    out[-1] += interior[-1]
    return out


def check_lat_long(env: np.ndarray, where: str | Path) -> np.ndarray:
    """Raise InputError unless `env` is a usable 2:1 radiance map; returns it as float32."""
    if env.ndim != 3 or env.shape[2] != 3:
        raise InputError(
            f"expected three channels, got an array of shape {env.shape}", where, "save it as RGB"
        )

    h, w = env.shape[:2]
    if abs(w / h - 2) > 0.04:
        raise InputError(
            f"{w}x{h} is not a 2:1 lat-long map", where, "convert it to equirectangular projection"
        )

    if not np.isfinite(env).all() or env.min() < 0:
        raise InputError(
            "holds NaN, infinite or negative radiance",
            where,
            "replace those pixels (0 or a neighbour's)",
        )
    return env.astype(np.float32)
