"""The suite's eight objects: shapes and solid materials.

A material is a function (points (n, 3), noise) -> base colour (n, 3) linear Rec.709, roughness (n,)
and metallic (n,). Frame: Z-up; objects fit into a ball of radius 1.05 about the origin.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.make_scene import TRANSMISSION
from benchmarks.suite.patches import (
    Patch,
    assembled,
    cube_faces,
    ellipsoid,
    even_sphere,
    in_pieces,
    mapped,
    revolved,
    rounded_box,
    texel_points,
    tiles,
    turn,
)
from benchmarks.suite.solid_noise import SolidNoise
from pipeline.base.errors import InputError, nearest
from pipeline.base.images import linear_to_srgb, write_png
from pipeline.geometry.mesh_io import save_mesh

Material = Callable[[np.ndarray, SolidNoise], tuple[np.ndarray, np.ndarray, np.ndarray]]

# Linear colours; those of metals after their measured reflectance at normal incidence
# (physicallybased.info, CC0).
LAST = "metallic.png"  # of an asset folder: what is written last
GOLD = (0.94, 0.68, 0.27)
COPPER = (0.93, 0.50, 0.37)
STEEL = (0.56, 0.55, 0.53)
BRASS = (0.89, 0.72, 0.39)
CLAY = (0.42, 0.20, 0.11)
CHALK = (0.72, 0.70, 0.64)
MOSS = (0.12, 0.22, 0.07)
INK = (0.04, 0.05, 0.10)
CREAM = (0.75, 0.66, 0.48)
RED = (0.52, 0.06, 0.05)
TEAL = (0.05, 0.27, 0.28)
LEATHER = (0.22, 0.10, 0.05)


@dataclass
class Thing:
    """kind: what the object stands for in the tables; side: cells are chosen for a mesh of some
    ten thousand faces; transmission: share of the light that goes through the surface.
    """

    kind: str
    patches: Callable[[], list[Patch]]
    materials: tuple[Material, ...]
    transmission: float = 0.0


def mix(a, b, share: np.ndarray) -> np.ndarray:
    """Colours (n, 3) from a at share 0 to b at 1."""
    share = np.clip(share, 0, 1)[:, None]
    return (1 - share) * np.array(a) + share * np.array(b)


def step(value: np.ndarray, width: float = 0.03) -> np.ndarray:
    """0 below, 1 above zero, over a soft edge."""
    return np.clip(0.5 + value / width, 0, 1)


def mottled(
    one, two, scale: float, roughness: tuple[float, float], metallic: float = 0
) -> Material:
    """Two colours by noise; roughness goes with finer noise between two values."""

    def material(points: np.ndarray, noise: SolidNoise):
        color = mix(one, two, 0.5 + 1.2 * noise.fractal(points * scale))
        fine = np.clip(0.5 + noise.fractal(points * 2.5 * scale + 31), 0, 1)
        low, high = roughness
        return color, low + (high - low) * fine, np.full(len(points), metallic)

    return material


def striped(one, two, repeats: float, roughness: tuple[float, float]) -> Material:
    """Bands in height with wavy edges; each kind of band has its roughness."""

    def material(points: np.ndarray, noise: SolidNoise):
        wave = np.sin(np.pi * repeats * points[:, 2] + 1.5 * noise(points * 3))
        share = step(wave, 0.2)
        shade = 1 + 0.25 * noise.fractal(points * 6)
        rough = roughness[0] + (roughness[1] - roughness[0]) * share
        return mix(one, two, share) * shade[:, None], rough, np.zeros(len(points))

    return material


def worn(paint, metal, wear: float, roughness: tuple[float, float]) -> Material:
    """Paint over metal, worn off where noise is above `wear`; roughness of paint and of metal."""

    def material(points: np.ndarray, noise: SolidNoise):
        bare = step(noise.fractal(points * 2.2) - wear, 0.04)
        color = mix(paint, metal, bare) * (1 + 0.15 * noise(points * 14))[:, None]
        rough = mix((roughness[0],) * 3, (roughness[1],) * 3, bare)[:, 0]
        return color, rough + 0.06 * noise(points * 9), (bare > 0.5).astype(float)

    return material


def pedestal_ball() -> list[Patch]:
    foot = np.array(
        [(0, -0.95), (0.55, -0.95), (0.6, -0.9), (0.55, -0.8), (0.38, -0.68), (0.34, -0.4)]
        + [(0.4, -0.25), (0.5, -0.18), (0.48, -0.12), (0, -0.12)]
    )
    ball = mapped(cube_faces(24, 1), lambda p: 0.5 * even_sphere(p) + [0, 0, 0.36])
    return in_pieces(revolved(foot, (64, 80)), 2) + ball


def torus_knot() -> list[Patch]:
    def centre(t: np.ndarray) -> np.ndarray:
        ring = 2 + np.cos(3 * t)
        return 0.27 * np.stack(
            [ring * np.cos(2 * t), ring * np.sin(2 * t), 1.4 * np.sin(3 * t)], -1
        )

    def surface(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        t = turn(u)
        ahead, behind = centre(t + 1e-3), centre(t - 1e-3)
        tangent = ahead - behind
        tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
        inward = ahead + behind - 2 * centre(t)
        inward -= (inward * tangent).sum(1, keepdims=True) * tangent
        inward /= np.linalg.norm(inward, axis=1, keepdims=True)
        side = np.cross(tangent, inward)
        angle = -turn(v)[:, None]
        return centre(t) + 0.17 * (np.cos(angle) * inward + np.sin(angle) * side)

    return in_pieces(Patch(surface, (378, 28)), 9)


def bowl() -> list[Patch]:
    profile = np.array(
        [(0, -0.5), (0.32, -0.5), (0.36, -0.46), (0.4, -0.4), (0.75, -0.1), (0.93, 0.3)]
        + [(0.97, 0.42), (0.94, 0.45), (0.9, 0.42), (0.84, 0.28), (0.66, -0.04), (0.35, -0.27)]
        + [(0, -0.33)]
    )
    return in_pieces(revolved(profile, (96, 96)), 4)


def rounded_case() -> list[Patch]:
    body = rounded_box((0.72, 0.5, 0.55), 0.12, 24, 0)
    band = rounded_box((0.75, 0.53, 0.09), 0.04, 16, 1)
    knobs = [
        ellipsoid((0.5 * x, 0.5 * y, 0.35 * z), (0.07, 0.07, 0.06), (0, y, 0), 1, (20, 12))
        for x in (-1, 1)
        for y in (-1, 1)
        for z in (-1, 1)
    ]
    handle = [ellipsoid((0, 0, 0.6), (0.1, 0.1, 0.42), (1, 0, 0), 2, (32, 24))]
    return body + band + knobs + handle


def vase() -> list[Patch]:
    profile = np.array(
        [(0, -1), (0.3, -1), (0.33, -0.96), (0.3, -0.88), (0.5, -0.5), (0.58, -0.15)]
        + [(0.48, 0.25), (0.24, 0.55), (0.2, 0.7), (0.3, 0.92), (0.33, 0.96), (0.29, 0.94)]
        + [(0.17, 0.7), (0.2, 0.53), (0.4, 0.2), (0.3, -0.4), (0, -0.5)]
    )
    return in_pieces(revolved(profile, (72, 140)), 4)


def blob() -> list[Patch]:
    noise = SolidNoise(71)

    def change(points: np.ndarray) -> np.ndarray:
        unit = even_sphere(points)
        return unit * (0.72 + 0.42 * noise.fractal(1.3 * unit, 3))[:, None]

    return mapped(cube_faces(40), change)


def figure() -> list[Patch]:
    limb = lambda centre, radii, axis, part: ellipsoid(centre, radii, axis, part)
    foot = np.array([(0, -1), (0.5, -1), (0.52, -0.97), (0.5, -0.9), (0, -0.9)])
    return [
        limb((0, 0, 0.72), (0.17, 0.19, 0.22), (0, 0, 1), 0),
        limb((0, 0, 0.2), (0.28, 0.2, 0.4), (0, 0, 1), 1),
        limb((0, 0, 0.36), (0.33, 0.25, 0.16), (0, 0, 1), 2),
        limb((0.36, 0.05, 0.2), (0.1, 0.1, 0.36), (0.35, 0.1, -1), 0),
        limb((-0.4, 0.08, 0.42), (0.1, 0.1, 0.36), (-0.9, 0.3, 0.5), 0),
        limb((0.15, 0, -0.45), (0.13, 0.14, 0.5), (0.1, 0, -1), 1),
        limb((-0.15, 0, -0.45), (0.13, 0.14, 0.5), (-0.1, 0, -1), 1),
        limb((-0.64, 0.2, 0.6), (0.3, 0.3, 0.05), (-0.5, 1, 0.2), 2),
        revolved(foot, (48, 24), 3),
    ]


def fluted_ring() -> list[Patch]:
    def surface(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        around, across = turn(u), turn(v)
        tube = 0.27 * (1 + 0.16 * np.cos(9 * around + 2 * across))
        ring = 0.68 + tube * np.cos(across)
        upright = np.stack(
            [ring * np.cos(around), tube * np.sin(across), -ring * np.sin(around)], -1
        )
        return upright

    return in_pieces(Patch(surface, (216, 44)), 4)


OBJECTS = {
    "pedestal_ball": Thing(
        "diffuse",
        pedestal_ball,
        (mottled(CHALK, CLAY, 2.5, (0.75, 0.95)), striped(MOSS, CREAM, 5, (0.8, 0.9))),
    ),
    "torus_knot": Thing("glossy", torus_knot, (mottled(RED, CREAM, 2.0, (0.12, 0.3)),)),
    "bowl": Thing("concave", bowl, (striped(TEAL, CHALK, 4, (0.2, 0.6)),)),
    "rounded_case": Thing(
        "mixed",
        rounded_case,
        (
            mottled(LEATHER, CLAY, 4.0, (0.45, 0.75)),
            mottled(BRASS, GOLD, 3.0, (0.2, 0.4), 1.0),
            worn(INK, STEEL, 0.25, (0.5, 0.3)),
        ),
    ),
    "vase": Thing("glossy", vase, (striped(INK, CREAM, 6, (0.1, 0.45)),)),
    "blob": Thing("metal", blob, (mottled(GOLD, COPPER, 1.5, (0.15, 0.5), 1.0),)),
    "figure": Thing(
        "mixed",
        figure,
        (
            mottled(CREAM, CLAY, 3.0, (0.5, 0.7)),
            mottled(TEAL, INK, 3.0, (0.7, 0.95)),
            mottled(STEEL, BRASS, 2.0, (0.2, 0.45), 1.0),
            mottled(CHALK, MOSS, 3.0, (0.6, 0.9)),
        ),
    ),
    "fluted_ring": Thing("metal", fluted_ring, (worn(RED, STEEL, 0.1, (0.35, 0.25)),)),
}


def textures(patches: list[Patch], materials: tuple[Material, ...], side: int, seed: int):
    """Base colour (side, side, 3), roughness and metallic (side, side) of an atlas."""
    across = tiles(len(patches))
    noise = SolidNoise(seed)
    color = np.full((side, side, 3), 0.5)
    roughness = np.full((side, side), 0.5)
    metallic = np.zeros((side, side))

    size = side // across
    for k, patch in enumerate(patches):
        column, row = size * (k % across), size * (across - 1 - k // across)
        points = texel_points(patch, size).reshape(-1, 3)
        shape = (size, size)
        here = slice(row, row + size), slice(column, column + size)
        found = materials[patch.part](points, noise)
        color[here] = np.clip(found[0], 0.02, 0.95).reshape(*shape, 3)
        roughness[here] = np.clip(found[1], 0.08, 1).reshape(shape)
        metallic[here] = found[2].reshape(shape)
    return color, roughness, metallic


def write_thing(thing: Thing, out: Path, side: int, seed: int) -> None:
    """The asset folder that benchmarks.make_scene reads: mesh.ply, base_color.png (sRGB),
    roughness.png and metallic.png of `side` texels, and for a thing that light goes through
    transmission.png. seed: of the materials' noise.
    """
    patches = thing.patches()
    across = tiles(len(patches))
    side = across * (side // across)  # tiles of whole texels

    out.mkdir(parents=True, exist_ok=True)
    save_mesh(out / "mesh.ply", assembled(patches))
    color, roughness, metallic = textures(patches, thing.materials, side, seed)
    write_png(out / "base_color.png", np.round(linear_to_srgb(color) * 255))
    write_png(out / "roughness.png", np.round(roughness * 255))
    if thing.transmission:
        write_png(out / TRANSMISSION, np.round(np.full((side, side), 255 * thing.transmission)))
    write_png(out / LAST, np.round(metallic * 255))


def write_object(name: str, out: Path, side: int = 512) -> None:
    """As `write_thing`, of the object `name`. Raises InputError for an unknown name."""
    if name not in OBJECTS:
        raise InputError(f"there is no object '{name}'", "suite", nearest(name, OBJECTS))
    write_thing(OBJECTS[name], out, side, seed_of(name))


def seed_of(name: str) -> int:
    """Of the noise in an object's materials."""
    return list(OBJECTS).index(name) + 500
