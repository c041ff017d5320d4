"""What a data set's folder holds, in one form for all layouts, before it is written.

Frames: poses are camera to world (4, 4) with OpenGL axes (x right, y up, z back) in the set's
Z-up world, as transforms.json has them; lights are lat-long in Heliograph's Y-up frame.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

import numpy as np

from pipeline.base.errors import InputError

T = TypeVar("T")
LIGHT_ROWS = 256
LEAST_PHOTOS = 3  # as pipeline.photos.scene_files.find_photos asks
OWN_FILE = "use the set's own file"
WHOLE_SET = "use the whole set"


@dataclass(frozen=True)
class Options:
    """What the user may choose. lights: folder of lat-long maps, for sets that only name them;
    light: the one that the photos are taken from, where a set has several; relights: those to take
    (None: all); held_out: "test" or "val"; train, test: how many views at most, evenly spaced;
    side: longest side in pixels that pictures are scaled down to; light_rows: rows of the maps.
    """

    lights: Path | None = None
    light: str | None = None
    relights: tuple[str, ...] | None = None
    held_out: str = "test"
    train: int | None = None
    test: int | None = None
    side: int | None = None
    light_rows: int = LIGHT_ROWS


@dataclass(frozen=True)
class Shot:
    """One view. angle: horizontal field of view, radians; mask: a file, None for the photo's alpha;
    radiance: a linear picture of the same where the photo is not one; albedo: a file of base
    colour, linear or, with albedo_srgb, encoded.
    """

    name: str
    photo: Path
    pose: np.ndarray
    angle: float
    mask: Path | None = None
    radiance: Path | None = None
    albedo: Path | None = None
    albedo_srgb: bool = False


@dataclass(frozen=True)
class Relit:
    """Views under another light, which is read on demand. own: they are not the held-out views
    again, but views of their own.
    """

    name: str
    light: Callable[[], np.ndarray]
    shots: list[Shot]
    own: bool = False


@dataclass
class Content:
    """light: of the photos, read on demand; None where the set does not say. notes: what the set
    does not have, and what was decided.
    """

    train: list[Shot]
    test: list[Shot]
    light: Callable[[], np.ndarray] | None = None
    relights: list[Relit] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)


def needed(path: Path, what: str, cure: str) -> Path:
    """The path, where it exists. Raises InputError."""
    if not path.exists():
        raise InputError(f"there is no {what}", path, cure)
    return path


def spaced(items: Sequence[T], most: int | None) -> list[T]:
    """At most so many of them, evenly spaced, the first included. Raises InputError where less than
    one is asked for.
    """
    if most is None:
        return list(items)
    if most < 1:
        raise InputError(f"{most} views", "--train, --test", "ask for one or more")
    count = min(most, len(items))
    return [items[k * len(items) // count] for k in range(count)]


def chosen_names(names: list[str], options: Options, where: Path) -> list[str]:
    """The other lights that --relights names, of those that the set has; all if it names none.
    Raises InputError for one that the set does not have.
    """
    if options.relights is None:
        return names
    for name in options.relights:
        if name not in names:
            raise InputError(
                f"it has no other light '{name}'",
                where,
                f"choose with --relights of: {', '.join(names) or 'none'}",
            )
    return list(options.relights)
