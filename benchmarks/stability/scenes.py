"""Scenes of the stability suite: small bases that nothing is wrong with, and what every scene is
rendered from.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from benchmarks.make_scene import Options, make_scene
from benchmarks.suite.make import light_file, relights_of
from benchmarks.suite.objects import OBJECTS, Thing, seed_of, write_thing
from pipeline.base.errors import InputError, nearest
from pipeline.base.images import write_exr

DONE = "transforms.json"


@dataclass(frozen=True)
class Base:
    """A scene of the suite: object and light by name."""

    thing: str
    light: str


BASES = {"vase": Base("vase", "room_4"), "figure": Base("figure", "sunny_9")}
BASE = "vase"  # of every knob, unless it says otherwise


@dataclass(frozen=True)
class Size:
    """options: of the scenes; side: texels of the true maps; draws: of a sampler; ends: each
    knob's first and last value only; settings: of the chain.
    """

    options: Options
    side: int = 256
    draws: int = 3
    ends: bool = False
    settings: dict = field(default_factory=dict)


SIZES = {
    "S": Size(Options(size=96, spp=128, views=16, test=2)),
    "XS": Size(
        Options(size=64, spp=32, views=12, test=2),
        side=128,
        ends=True,
        settings={"fit": {"steps": 60, "pixels": 1024}},
    ),
}


def size_named(name: str) -> Size:
    """Raises InputError for an unknown name."""
    if name not in SIZES:
        raise InputError(f"there is no size '{name}'", "--size", nearest(name, SIZES))
    return SIZES[name]


@dataclass(frozen=True)
class Recipe:
    """What a scene is rendered from. thing: what stands there; light: its map's name in the suite,
    or the map (h, 2h, 3).
    """

    thing: Thing
    light: str | np.ndarray
    options: Options
    relights: tuple[str, ...]
    seed: int
    side: int


def base_recipe(base: Base, size: Size) -> Recipe:
    """Of the scene that nothing is wrong with."""
    relights = tuple(relights_of(base.light))
    seed = seed_of(base.thing)
    return Recipe(OBJECTS[base.thing], base.light, size.options, relights, seed, size.side)


def scene_name(size: str, base: str, what: str = "") -> str:
    """s_vase, s_vase_blur_2: what a scene folder and its stages are called."""
    return "_".join(part for part in (size.lower(), base, what) if part)


def rendered(recipe: Recipe, folder: Path) -> None:
    """The scene folder of a recipe; its asset and lights lie beside it, in assets/ and lights/."""
    asset = asset_of(folder)
    write_thing(recipe.thing, asset, recipe.side, recipe.seed)
    library = folder.parent
    if isinstance(recipe.light, str):
        light = light_file(library, recipe.light)
    else:
        light = library / "lights" / f"{folder.name}.exr"
        write_exr(light, recipe.light)
    others = [light_file(library, name) for name in recipe.relights]
    make_scene(asset, light, others, recipe.options, folder)


def asset_of(folder: Path) -> Path:
    """Where the object of a scene folder lies."""
    return folder.parent / "assets" / folder.name


def randomness(knob: str) -> np.random.Generator:
    """The same at every value of a knob, so that a curve is of one case that gets worse."""
    return np.random.default_rng(zlib.crc32(knob.encode()))
