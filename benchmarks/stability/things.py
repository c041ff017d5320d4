"""Objects whose material or shape is the knob: variants of those of benchmarks/suite/objects.py.

A material function gets the points of one patch only; what shares and means are taken of are fixed
points in the unit ball, so that all patches of an object agree on them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from benchmarks.suite.objects import (
    CHALK,
    CREAM,
    OBJECTS,
    Material,
    Thing,
    bowl,
    mottled,
    striped,
)
from benchmarks.suite.patches import Patch, ellipsoid, mapped
from benchmarks.suite.solid_noise import SolidNoise

MIRROR = (0.9, 0.9, 0.9)
SHARPEST = 0.08  # roughness; sharper lobes are no material of the suite, nor of the renderer
REFERENCE = np.random.default_rng(0).uniform(-0.6, 0.6, (4000, 3))
PATCHES = 1.5  # of what a share of the surface has, per unit of length


def with_materials(thing: Thing, change: Callable[[Material], Material]) -> Thing:
    """The thing with every material changed."""
    return replace(thing, materials=tuple(change(material) for material in thing.materials))


def where(points: np.ndarray, noise: SolidNoise, share: float) -> np.ndarray:
    """Which points (n,) belong to patches that make up about this share of the surface."""
    field = lambda p: noise.fractal(PATCHES * p + 9)
    if share in (0, 1):
        return np.full(len(points), bool(share))
    return field(points) < np.quantile(field(REFERENCE), share)


def of_transmission(thing: Thing, share: float) -> Thing:
    """A frosted glass, as rough as it was, that this share of the light goes through."""
    return replace(thing, transmission=share)


def of_roughness(thing: Thing, roughness: float) -> Thing:
    """One roughness all over."""

    def change(inner: Material) -> Material:
        def material(points: np.ndarray, noise: SolidNoise):
            color, _, metallic = inner(points, noise)
            return color, np.full(len(points), roughness), metallic

        return material

    return with_materials(thing, change)


def of_metal_share(thing: Thing, share: float) -> Thing:
    """Metal, of the same colours, on this share of the surface besides what is metal already."""

    def change(inner: Material) -> Material:
        def material(points: np.ndarray, noise: SolidNoise):
            color, roughness, metallic = inner(points, noise)
            return color, roughness, np.maximum(metallic, where(points, noise, share))

        return material

    return with_materials(thing, change)


def of_mirror_share(thing: Thing, share: float) -> Thing:
    """Polished metal on this share of the surface."""

    def change(inner: Material) -> Material:
        def material(points: np.ndarray, noise: SolidNoise):
            color, roughness, metallic = inner(points, noise)
            bare = where(points, noise, share)
            color = np.where(bare[:, None], MIRROR, color)
            return color, np.where(bare, SHARPEST, roughness), np.where(bare, 1.0, metallic)

        return material

    return with_materials(thing, change)


def of_albedo(thing: Thing, mean: float) -> Thing:
    """Base colours times the factor that brings their mean to `mean`."""

    def change(inner: Material) -> Material:
        def material(points: np.ndarray, noise: SolidNoise):
            color, roughness, metallic = inner(points, noise)
            return color * mean / inner(REFERENCE, noise)[0].mean(), roughness, metallic

        return material

    return with_materials(thing, change)


def of_texture_share(thing: Thing, share: float) -> Thing:
    """Texture on this share of the surface, its mean colour and roughness elsewhere."""

    def change(inner: Material) -> Material:
        def material(points: np.ndarray, noise: SolidNoise):
            color, roughness, metallic = inner(points, noise)
            means = [values.mean(0) for values in inner(REFERENCE, noise)[:2]]
            textured = where(points, noise, share)
            color = np.where(textured[:, None], color, means[0])
            return color, np.where(textured, roughness, means[1]), metallic

        return material

    return with_materials(thing, change)


def bowl_of_depth(depth: float) -> Thing:
    """A white bowl, as deep as the suite's at 1: light between its walls bounces often."""
    deeper = lambda: mapped(bowl(), lambda points: points * [1, 1, depth])
    return Thing("concave", deeper, (striped(CHALK, CREAM, 4, (0.6, 0.8)),))


def rods(radius: float) -> Thing:
    """Six rods of this radius and a ball in the middle."""
    axes = [(1, 0, 0.5), (-0.5, 0.87, 0.5), (-0.5, -0.87, 0.5)]
    axes += [(1, 0, -0.6), (-0.5, 0.87, -0.6), (-0.5, -0.87, -0.6)]
    of = lambda axis: ellipsoid((0, 0, 0), (radius, radius, 1), axis, 0, (24, 48))
    ball = ellipsoid((0, 0, 0), (0.3, 0.3, 0.3), part=1)
    materials = (
        mottled(CHALK, CREAM, 3, (0.3, 0.5)),
        striped(CHALK, (0.5, 0.1, 0.1), 6, (0.3, 0.6)),
    )
    return Thing("thin", lambda: [*map(of, axes), ball], materials)


def several(names: tuple[str, ...], count: int) -> Thing:
    """The first `count` of the suite's objects named, side by side; one alone has its full size."""
    things = [OBJECTS[name] for name in names[:count]]
    starts = np.cumsum([0] + [len(thing.materials) for thing in things])
    angle = 2 * np.pi * np.arange(count) / count
    middles = 0.58 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], 1) * (count > 1)
    size = 1.0 if count == 1 else 0.48

    def patches() -> list[Patch]:
        out = []
        for thing, middle, start in zip(things, middles, starts):
            placed = mapped(thing.patches(), lambda p, m=middle: size * p + m)
            out += [replace(patch, part=patch.part + int(start)) for patch in placed]
        return out

    return Thing("several", patches, sum((thing.materials for thing in things), ()))
