"""What is known of a rendered scene: the truth that an asset is scored against.

A scene folder (docs/scene_folder.md) with transforms_test.json, masks/ and truth/ as
benchmarks/make_scene.py and benchmarks/layouts write them. Every picture may lie beside it once
more under again/, rendered with noise of its own. Light, maps and relit views may be missing: then
their scores are too, and a note says so.

In memory radiance is in the scene's unit (pipeline/photos/radiance.py), as everywhere in the
pipeline.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from PIL import Image

from pipeline.base.errors import InputError
from pipeline.base.files import json_entry
from pipeline.base.images import read_exr, read_png, srgb_to_linear
from pipeline.geometry.cameras import View
from pipeline.photos.given_cameras import read_transforms
from pipeline.photos.radiance import Radiance, level_of, white_of
from pipeline.photos.scene_files import mask_file, named_frames, photo_name
from pipeline.render.envmap import check_lat_long
from pipeline.render.observe import Tracer, inner_mask

CAMERAS = "transforms_test.json"
RIM = 1.5  # pixels at the mask's edge, where object and background mix
MAPS = ("albedo", "roughness", "metallic")
CURE = "make the scene with python -m benchmarks.suite.make, or with benchmarks.layouts"


@dataclass
class Picture:
    """A true picture (h, w, 3), linear, and a second render of it, None where there is none."""

    pixels: np.ndarray
    again: np.ndarray | None

    @property
    def mean(self) -> np.ndarray:
        """Mean of both, where there are two."""
        return self.pixels if self.again is None else 0.5 * (self.pixels + self.again)

    def over(self, white: float) -> Picture:
        """The same in the unit in which `white` is 1."""
        return Picture(self.pixels / white, None if self.again is None else self.again / white)


@dataclass
class TrueView:
    """A held-out view. outline: the object (h, w); mask: the same less a rim; photo: the view in
    the scene's light; maps: albedo (h, w, 3), roughness and metallic (h, w), those that are known.
    """

    view: View
    outline: np.ndarray
    mask: np.ndarray
    photo: Picture
    maps: dict[str, np.ndarray]


@dataclass
class Relit:
    """Views under another light (h, 2h, 3): the held-out ones again, or views of their own."""

    light: np.ndarray
    views: list[TrueView]
    pictures: list[Picture]

    def over(self, white: float) -> Relit:
        """The same in the unit in which `white` is 1."""
        views = [replace(view, photo=view.photo.over(white)) for view in self.views]
        return Relit(self.light / white, views, [shown.over(white) for shown in self.pictures])


@dataclass
class Truth:
    """light: (h, 2h, 3), None where it is not known; relights: by name. notes: what the folder
    lacks. white: the radiance, in the folder's unit, that is 1 here.
    """

    views: list[TrueView]
    light: np.ndarray | None
    relights: dict[str, Relit]
    notes: list[str]
    white: float = 1.0

    def known_light(self) -> np.ndarray:
        """The light. Raises InputError where it is not known."""
        if self.light is None:
            raise InputError("the truth has no light", "truth/envmap.exr", CURE)
        return self.light


def needed(path: Path, what: str) -> Path:
    """The path, where it exists. Raises InputError."""
    if not path.exists():
        raise InputError(f"the truth has no {what}", path, CURE)
    return path


def picture(file: Path) -> Picture:
    """A picture and, from again/ beside it, its second render."""
    again = file.parent / "again" / file.name
    return Picture(read_exr(file), read_exr(again) if again.exists() else None)


def true_view(
    view: View, outline: np.ndarray, shown: Picture, maps: dict[str, np.ndarray], file: Path
) -> TrueView:
    """The view of the photo `file`. Raises InputError where its mask is of another size, or has
    nothing left when its rim is taken off.
    """
    mask = inner_mask(outline, RIM)
    if not mask.any():
        raise InputError("its mask is empty, or all rim", file, "leave the view out")
    return TrueView(view, outline, mask, of_size(shown, outline, file), maps)


def of_size(shown: Picture, outline: np.ndarray, file: Path) -> Picture:
    """The same picture. Raises InputError where the mask (h, w) of its view is of another size."""
    own, mask = shown.pixels.shape[1::-1], outline.shape[1::-1]
    if own != mask:
        raise InputError(
            f"it is {own[0]}x{own[1]}, its view's mask {mask[0]}x{mask[1]}", file, CURE
        )
    return shown


def photo_of(folder: Path, photo: Path, name: str, notes: list[str]) -> Picture:
    """The view's linear picture; its photo where there is none."""
    for file in (f"linear/{name}.exr", f"relight/{name}_self.exr"):
        if (folder / "truth" / file).exists():
            return picture(folder / "truth" / file)
    if photo.suffix.lower() == ".exr":
        return picture(photo)
    notes.append(f"{name} is compared with its 8-bit photo")
    return Picture(srgb_to_linear(read_png(photo) / 255.0), None)


def true_maps(truth: Path, name: str) -> dict[str, np.ndarray]:
    """Those of MAPS that the truth has for a view; roughness and metallic (h, w)."""
    found = {key: truth / key / f"{name}.exr" for key in MAPS}
    maps = {key: read_exr(file) for key, file in found.items() if file.exists()}
    grey = lambda values: values if values.ndim == 2 else values[..., 0]
    return {key: values if key == "albedo" else grey(values) for key, values in maps.items()}


def picture_size(photo: Path) -> tuple[int, int]:
    """Width and height."""
    if photo.suffix.lower() == ".exr":
        height, width = read_exr(photo).shape[:2]
        return width, height
    with Image.open(photo) as image:
        return image.size


def cameras_of(folder: Path, cameras: Path) -> list[tuple[Path, View]]:
    """Pictures that a transforms file names, with their cameras. Raises InputError."""
    photos = named_frames(folder, cameras)
    names = [photo_name(folder, path) for path in photos]
    sizes = {name: picture_size(path) for name, path in zip(names, photos)}
    poses = read_transforms(cameras, folder, sizes)
    found = []
    for path, name in zip(photos, names):
        lens, pose = poses[name]
        view = View(name, "", *sizes[name], lens.fx, lens.fy, lens.cx, lens.cy, pose, split="test")
        found.append((path, view))
    return found


def held_out(folder: Path, notes: list[str]) -> list[TrueView]:
    """Views of transforms_test.json. Raises InputError naming what a folder lacks."""
    views = []
    for path, view in cameras_of(folder, needed(folder / CAMERAS, "held-out cameras")):
        mask = mask_file(folder, path)
        if mask is None:
            raise InputError(f"{view.name} has no mask", folder / "masks", "add it, white = object")
        outline = read_png(mask) > 127
        shown = photo_of(folder, path, view.name, notes)
        maps = true_maps(folder / "truth", view.name)
        views.append(true_view(view, outline, shown, maps, path))
    return views


def white_of_views(folder: Path, views: list[TrueView]) -> float:
    """The radiance that is white in a scene of which no more is known than these held-out views: 1,
    the full scale of its photos, unless all of them are EXRs, whose unit may be any.
    """
    photos = named_frames(folder, folder / CAMERAS)
    if any(photo.suffix.lower() != ".exr" for photo in photos):
        return 1.0
    return white_of([level_of(known.photo.mean, known.outline) for known in views])


def truth_of_work(folder: Path, work: Path) -> Truth:
    """The truth of a scene's folder in the unit of its work folder: capture has found the white
    from all photos, and what lies there is over it. Raises InputError naming what a folder lacks.
    """
    return load_truth(folder, Radiance.load(work / "capture").white)


def load_truth(folder: Path, white: float | None = None) -> Truth:
    """The truth in the scene's unit, in which the radiance `white` of the folder is 1; None: as its
    held-out views show, for an asset that comes without its work folder. Raises InputError naming
    what a folder lacks.
    """
    needed(folder, "folder")
    notes: list[str] = []
    views = held_out(folder, notes)

    file = folder / "truth" / "envmap.exr"
    light = check_lat_long(read_exr(file), file) if file.exists() else None
    relights = relights_of(folder, views)
    about = folder / "truth" / "layout.json"
    if about.exists():
        notes += json_entry(about, "notes")
    else:
        notes += [] if light is not None else ["the truth has no light"]
        notes += [] if relights else ["the truth has no view under another light"]

    if white is None:
        white = white_of_views(folder, views)
    return Truth(
        [replace(known, photo=known.photo.over(white)) for known in views],
        None if light is None else light / white,
        {name: relit.over(white) for name, relit in relights.items()},
        notes,
        white,
    )


def relights_of(scene: Path, views: list[TrueView]) -> dict[str, Relit]:
    """Other lights and the views under them, held-out ones (`views`) or, with a transforms.json of
    theirs, others; lights without a folder of views are passed over. Raises InputError where one
    lacks a view.
    """
    out = {}
    for file in sorted((scene / "truth" / "relight").glob("*.exr")):
        folder = file.with_suffix("")
        if not folder.is_dir():
            continue
        light = check_lat_long(read_exr(file), file)
        if (folder / "transforms.json").exists():
            own = own_views(scene, folder)
            out[file.stem] = Relit(light, own, [view.photo for view in own])
        else:
            files = [needed(folder / f"{v.view.name}.exr", "relit view") for v in views]
            pictures = [of_size(picture(f), v.outline, f) for f, v in zip(files, views)]
            out[file.stem] = Relit(light, views, pictures)
    return out


def own_views(scene: Path, folder: Path) -> list[TrueView]:
    """Views that one relight has alone, called by their files; their masks lie in its folder
    masks/. Raises InputError.
    """
    views = []
    for path, view in cameras_of(scene, folder / "transforms.json"):
        outline = read_png(needed(folder / "masks" / f"{path.stem}.png", "mask")) > 127
        named = replace(view, name=path.stem)
        views.append(true_view(named, outline, picture(path), {}, path))
    return views


def outline_overlap(mesh: Path, truth: Truth) -> float:
    """Intersection over union of an asset's outline and the true ones, all views together. mesh: a
    file in the cameras' Y-up world.
    """
    tracer = Tracer(mesh)
    both = either = 0
    for known in truth.views:
        rays = known.view.rays(known.view.pixel_centers().reshape(-1, 2))
        hit = tracer.hit(*rays)[2].reshape(known.outline.shape)
        both += int((hit & known.outline).sum())
        either += int((hit | known.outline).sum())
    return both / max(either, 1)
