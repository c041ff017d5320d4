"""A scene folder with one thing spoilt in it: photos, masks, cameras or mesh that a change of
benchmarks/stability writes anew. What a scene is scored by (truth/, the test views) stays.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np

from pipeline.base.files import read_json, write_json
from pipeline.base.images import read_exr, read_png, to_srgb8, write_exr, write_png
from pipeline.geometry.mesh_io import Mesh, load_mesh, save_mesh

Spoiler = Callable[[Path, float, np.random.Generator], None]  # scene folder, value, randomness


def copied(base: Path, out: Path) -> None:
    """`out` as a copy of the scene folder `base`; truth/ is a link, for nothing writes there."""
    shutil.copytree(base, out, ignore=shutil.ignore_patterns("truth"), dirs_exist_ok=True)
    (out / "truth").symlink_to(base.resolve() / "truth", target_is_directory=True)


def fit_photos(folder: Path) -> list[Path]:
    """The photos that are not held out, in order."""
    return sorted((folder / "images").glob("train_*.png"))


def fit_masks(folder: Path) -> np.ndarray:
    """Their masks (n, h, w), bool."""
    return np.array([read_png(folder / "masks" / p.name) > 127 for p in fit_photos(folder)])


def linear_photos(folder: Path) -> np.ndarray:
    """Their light (n, h, w, 3) before it is clipped and rounded."""
    linear = folder / "truth" / "linear"
    return np.array([read_exr(linear / f"{p.stem}.exr") for p in fit_photos(folder)])


def write_photos(folder: Path, photos: np.ndarray) -> None:
    """Linear photos (n, h, w, 3) in place of those that are there."""
    for path, photo in zip(fit_photos(folder), photos):
        write_png(path, to_srgb8(photo))


def on_photos(change) -> Spoiler:
    """change(linear photos, masks, value, rng) -> linear photos."""

    def spoil(folder: Path, value: float, rng: np.random.Generator) -> None:
        found = change(linear_photos(folder), fit_masks(folder), value, rng)
        write_photos(folder, found)

    return spoil


def on_exposure(gain) -> Spoiler:
    """gain(linear photos, masks, value) -> factor of all photos. What is known of the light is at
    their exposure: truth/ becomes a copy.
    """

    def spoil(folder: Path, value: float, rng: np.random.Generator) -> None:
        photos = linear_photos(folder)
        factor = gain(photos, fit_masks(folder), value)
        write_photos(folder, photos * factor)
        if factor != 1:
            expose_truth(folder, factor)

    return spoil


def expose_truth(folder: Path, factor: float) -> None:
    """The scene's own light and pictures in it, held-out photos among them, times `factor`."""
    truth = folder / "truth"
    origin = truth.resolve()
    truth.unlink()
    shutil.copytree(origin, truth)
    own = [truth / "envmap.exr", *truth.glob("linear/**/*.exr"), *truth.glob("relight/*_self.exr")]
    for file in own:
        write_exr(file, read_exr(file) * np.float32(factor))
    for file in folder.glob("images/test_*.png"):
        write_png(file, to_srgb8(read_exr(truth / "linear" / f"{file.stem}.exr")))


def on_pictures(change) -> Spoiler:
    """change(8-bit picture, value) -> 8-bit picture."""

    def spoil(folder: Path, value: float, rng: np.random.Generator) -> None:
        for path in fit_photos(folder):
            write_png(path, change(read_png(path), value))

    return spoil


def on_masks(change) -> Spoiler:
    """change(masks, value, rng) -> masks, None for a missing one."""

    def spoil(folder: Path, value: float, rng: np.random.Generator) -> None:
        for path, mask in zip(fit_photos(folder), change(fit_masks(folder), value, rng)):
            file = folder / "masks" / path.name
            if mask is None:
                file.unlink()
            else:
                write_png(file, mask * np.uint8(255))

    return spoil


def on_cameras(change) -> Spoiler:
    """change(content of transforms.json, value, rng) -> content."""

    def spoil(folder: Path, value: float, rng: np.random.Generator) -> None:
        file = folder / "transforms.json"
        write_json(file, change(read_json(file), value, rng))

    return spoil


def on_mesh(change) -> Spoiler:
    """change(mesh, value, rng) -> mesh."""

    def spoil(folder: Path, value: float, rng: np.random.Generator) -> None:
        mesh: Mesh = load_mesh(folder / "mesh.ply")
        save_mesh(folder / "mesh.ply", change(mesh, value, rng))

    return spoil
