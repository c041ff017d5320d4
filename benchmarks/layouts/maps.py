"""Lat-long maps of data sets in Heliograph's frame, and where to find them.

Heliograph: Y-up, u = .5 - lon / 2 pi with lon = atan2(x, z) (pipeline/render/envmap.py).
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from benchmarks.layouts.content import Options
from pipeline.base.errors import InputError
from pipeline.geometry.cameras import Y_FROM_Z_UP
from pipeline.prior.training.sources import read_source
from pipeline.render.envmap import direction_from_uv, resample_area

SUFFIXES = (".hdr", ".exr")
FINER = 3  # odd: where frames differ by whole columns, maps stay as they are
LARGER = 4  # times the rows asked for, to which larger maps are averaged first
Look = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]


def blender_uv(d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """u, v (n,) in [0, 1] of unit directions (n, 3), Z-up, as Blender maps a world's picture: +X in
    the middle, -Y at three quarters. NeRFactor and TensoIR render with it.
    """
    return 0.5 - np.arctan2(d[:, 1], d[:, 0]) / (2 * np.pi), np.arccos(d[:, 2].clip(-1, 1)) / np.pi


def skylibs_uv(d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """As `blender_uv`, Y-up, as skylibs maps its "latlong": -Z in the middle, +X at three
    quarters. Stanford-ORB's maps have it in the axes of a camera that looks along -Z.
    """
    return 0.5 + np.arctan2(d[:, 0], -d[:, 2]) / (2 * np.pi), np.arccos(d[:, 1].clip(-1, 1)) / np.pi


def in_our_frame(env: np.ndarray, look: Look, local: np.ndarray, rows: int) -> np.ndarray:
    """Radiance (h, 2h, 3), at most `rows` of them, float32. env: the set's map; look: direction to
    u, v in it; local: rotation (3, 3) from the set's Z-up world to the axes that `look` takes.

    A pixel is the mean of what FINER x FINER directions in it, or more, meet in the set's map.
    """
    if len(env) > LARGER * rows:
        env = resample_area(env, LARGER * rows, 2 * LARGER * rows)
    h, w = env.shape[:2]
    fine = FINER * h
    across = (np.arange(2 * fine) + 0.5) / (2 * fine)
    met = np.empty((fine, 2 * fine, 3), np.float32)
    for row in range(fine):  # one by one: all directions take 100 times the map's memory
        theirs = direction_from_uv(across, (row + 0.5) / fine) @ Y_FROM_Z_UP[:3, :3] @ local.T
        u, v = look(theirs)
        met[row] = env[np.minimum((v * h).astype(int), h - 1), (u % 1 * w).astype(int) % w]

    out = min(h, rows)
    return resample_area(met, out, 2 * out)


def map_file(name: str, options: Options) -> Path | None:
    """The map of that name in the folder that --lights gives, if there is one. Raises InputError
    where that folder has no map at all.
    """
    if options.lights is None:
        return None
    if not any(file.suffix in SUFFIXES for file in options.lights.glob("*")):
        raise InputError(
            "there is no such folder, or no .hdr and no .exr in it",
            options.lights,
            "give the folder of the set's lat-long maps with --lights",
        )
    places = (options.lights / f"{name}{suffix}" for suffix in SUFFIXES)
    return next((place for place in places if place.exists()), None)


def blender_light(file: Path, strength: float, rows: int) -> Callable[[], np.ndarray]:
    """Reads a map that Blender shows as the world's at that strength."""

    def read() -> np.ndarray:
        return strength * in_our_frame(read_source(file), blender_uv, np.eye(3), rows)

    return read


def camera_light(file: Path, pose: np.ndarray, rows: int) -> Callable[[], np.ndarray]:
    """Reads a map that was taken in the axes of a camera with this pose (OpenGL, Z-up world)."""

    def read() -> np.ndarray:
        return in_our_frame(read_source(file), skylibs_uv, pose[:3, :3].T, rows)

    return read
