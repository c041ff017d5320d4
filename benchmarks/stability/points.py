"""Points of the suite's curves: a knob's value on a base scene, and the scene folder of each."""

from __future__ import annotations

import contextlib
import fcntl
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from benchmarks.stability import lights
from benchmarks.stability.knobs import KNOBS, knob_named, with_views
from benchmarks.stability.scenes import (
    BASE,
    BASES,
    DONE,
    Recipe,
    asset_of,
    base_recipe,
    randomness,
    rendered,
    scene_name,
    size_named,
)
from benchmarks.stability.spoil import copied, write_photos
from pipeline.base.files import stage_folder


@dataclass(frozen=True)
class Point:
    """A knob's value on a base scene."""

    size: str
    base: str
    knob: str
    value: float

    @property
    def harmless(self) -> Point:
        return replace(self, value=KNOBS[self.knob].values[0])

    @property
    def changed(self) -> bool:
        """Whether anything in the scene is not as at the first value."""
        return self.value != KNOBS[self.knob].values[0] and not KNOBS[self.knob].of_the_run

    @property
    def scene(self) -> str:
        """Name of the scene folder, and of its stages."""
        knob = KNOBS[self.knob]
        if knob.render is with_views and self.value == size_named(self.size).options.views:
            return scene_name(self.size, self.base)
        what = f"{self.knob}_{self.value:g}".replace(".", "p").replace("-", "m")
        if not self.changed:
            what = (knob.harmless or what) if knob.own_base else ""
        return scene_name(self.size, self.base, what)

    @property
    def seeds(self) -> list[int]:
        return KNOBS[self.knob].seeds(self.value, size_named(self.size).draws)


def points_of(size: str, names: list[str], base: str = BASE) -> list[Point]:
    """Every value of the knobs: all harmless ones first, then the hardest ones, then those between,
    so that a run that is cut short knows most.
    """
    ranks = [0, -1] if size_named(size).ends else [0, -1, 2, 1]
    return [Point(size, base, name, knob_named(name).values[r]) for r in ranks for name in names]


@contextlib.contextmanager
def alone(folder: Path) -> Iterator[None]:
    """Wait until no other process is in this block for the same folder: scenes are made from one
    another.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / ".lock").open("w") as handle:
        fcntl.flock(handle, fcntl.LOCK_EX)
        yield


def make_scene_of(point: Point, out: Path) -> Path:
    """The scene folder of a point below `out`, made where it is not there. One process at a time:
    see `alone`.
    """
    folder = out / point.scene
    if (folder / DONE).exists():
        return folder
    knob = KNOBS[point.knob]
    recipe = base_recipe(BASES[point.base], size_named(point.size))
    if knob.render is not None:
        recipe = knob.render(recipe, point.value)
    spoils = knob.spoil is not None or knob.shoot is not None
    if point.changed and spoils:
        spoilt_copy(point, make_scene_of(point.harmless, out), recipe, folder)
    elif knob.without_mesh:
        base = out / scene_name(point.size, point.base)
        if not (base / DONE).exists():
            rendered(recipe, base)
        with stage_folder(folder, DONE) as new:
            copied(base, new)
            (new / "mesh.ply").unlink()
    else:
        rendered(recipe, folder)
    return folder


def spoilt_copy(point: Point, origin: Path, recipe: Recipe, folder: Path) -> None:
    """A copy of the scene folder `origin`, rendered from `recipe`, with the knob's change."""
    knob = KNOBS[point.knob]
    with stage_folder(folder, DONE) as new:
        copied(origin, new)
        if knob.spoil is not None:
            knob.spoil(new, point.value, randomness(point.knob))
        if knob.shoot is not None:
            shoot = lights.shoot_of(origin, asset_of(origin), recipe.options)
            write_photos(new, knob.shoot(shoot, point.value))
