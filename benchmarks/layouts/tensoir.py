"""TensoIR-synthetic (Jin et al. 2023), which is NeRFactor's layout (Zhang et al. 2021): a folder a
view, train_000 to test_199, each with metadata.json, albedo.png and RGBA pictures.

Facts, from data_gen/nerf_synth/render.py of github.com/google/nerfactor, and dataLoader/ and
scripts/ of github.com/Haian-Jin/TensoIR. metadata.json: `cam_transform_mat`, 16 numbers with
commas, camera to world row by row, OpenGL axes, Z-up; `cam_angle_x` horizontal, radians; `envmap`
and `envmap_inten`, the map of rgba.png and its strength. rgba.png shows the photos' light,
rgba_<name>.png the light of <name>.hdr at strength 1, in Blender's frame (`blender_uv`); rgba is
sRGB with straight alpha. albedo.png is linear, diffuse colour only. TensoIR's own configurations
take rgba_sunset*.png for the photos. normal.png (world, n / 2 + 1/2) is read by no score of ours.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from benchmarks.layouts.content import OWN_FILE, WHOLE_SET, Content, Options, Shot, needed, spaced
from benchmarks.layouts.lit import under_maps
from benchmarks.layouts.maps import blender_light, map_file
from pipeline.base.errors import InputError
from pipeline.base.files import read_json
from pipeline.photos.transforms_file import MOST_TURNED, Frame

OWN = "rgba.png"
CURE = "give the folder of one object, with train_000/, test_000/ and so on"


class Metadata(BaseModel):
    """metadata.json of a view."""

    model_config = ConfigDict(extra="ignore", frozen=True)

    cam_transform_mat: str
    cam_angle_x: Annotated[float, Field(gt=0, lt=MOST_TURNED)]
    envmap: str | None = None
    envmap_inten: Annotated[float, Field(gt=0, allow_inf_nan=False)] = 1.0

    def pose(self, file: Path) -> np.ndarray:
        """Camera to world (4, 4). Raises InputError."""
        try:
            numbers = [float(part) for part in self.cam_transform_mat.split(",")]
            rows = np.array(numbers).reshape(4, 4).tolist()
            frame = Frame(file_path=file.parent.name, transform_matrix=rows)
        except ValueError as error:  # ValidationError is one
            raise InputError(
                f"cam_transform_mat is no list of 16 numbers with commas between ({error})",
                file,
                OWN_FILE,
            ) from error
        return frame.camera_to_world(file)


def metadata(view: Path) -> Metadata:
    """Raises InputError naming file and key."""
    file = needed(view / "metadata.json", "metadata", CURE)
    try:
        return Metadata.model_validate(read_json(file))
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"]) or "the file"
        raise InputError(f"{key}: {first['msg']}", file, OWN_FILE) from error


def views_of(folder: Path, split: str) -> list[Path]:
    """Folders of a split's views. Raises InputError where there are none."""
    found = sorted(view for view in folder.glob(f"{split}_*") if view.is_dir())
    if not found:
        raise InputError(f"there is no folder {split}_000", folder, CURE)
    return found


def light_names(view: Path) -> list[str]:
    """Names of the lights of rgba_<name>.png."""
    return [file.stem.removeprefix("rgba_") for file in sorted(view.glob("rgba_*.png"))]


def photos_light(view: Path, chosen: str | None) -> tuple[str, str, float]:
    """Of the light that the photos are taken from: their file, its map's name and strength. Raises
    InputError where a set has several and none is chosen.
    """
    names = light_names(view)
    if chosen is not None:
        if chosen not in names:
            known = ", ".join(names) or "none"
            raise InputError(
                f"there is no rgba_{chosen}.png", view, f"choose with --light of: {known}"
            )
        return f"rgba_{chosen}.png", chosen, 1.0

    about = metadata(view)
    stem = Path(about.envmap).stem if about.envmap else "rgba"
    if (view / OWN).exists():
        return OWN, stem, about.envmap_inten
    if stem in names:
        return f"rgba_{stem}.png", stem, 1.0
    raise InputError(
        f"there is no {OWN}, and several lights: {', '.join(names) or 'none'}",
        view,
        "say with --light which one the photos are taken from (TensoIR: sunset)",
    )


def shots(views: list[Path], picture: str) -> list[Shot]:
    """Views in one light, with their base colour where all have it. Raises InputError."""
    colored = all((view / "albedo.png").exists() for view in views)
    found = []
    for view in views:
        about = metadata(view)
        photo = needed(view / picture, "picture", WHOLE_SET)
        albedo = view / "albedo.png" if colored else None
        pose = about.pose(view / "metadata.json")
        found.append(Shot(view.name, photo, pose, about.cam_angle_x, albedo=albedo))
    return found


def relit_picture(shot: Shot, name: str) -> Path:
    """A view's picture in another light. Raises InputError."""
    return needed(shot.photo.with_name(f"rgba_{name}.png"), "relit picture", WHOLE_SET)


def read(folder: Path, options: Options) -> Content:
    """Raises InputError naming what the folder lacks."""
    views = views_of(folder, "train")
    picture, own, strength = photos_light(views[0], options.light)
    train = shots(spaced(views, options.train), picture)
    held_out = spaced(views_of(folder, options.held_out), options.test)
    test = shots(held_out, picture)

    others = [name for name in light_names(held_out[0]) if name != own]
    relit, notes = under_maps(others, test, relit_picture, held_out[0], options)
    file = map_file(own, options)
    light = None if file is None else blender_light(file, strength, options.light_rows)
    if light is None:
        notes.append(f"the photos' light, {own}, has no map in --lights: it is not scored")
    if test[0].albedo is None:
        notes.append("not every held-out view has an albedo.png: base colour is not scored")
    notes.append("the set has no roughness and no metallic; its normals are not scored")
    return Content(train, test, light, relit, notes)
