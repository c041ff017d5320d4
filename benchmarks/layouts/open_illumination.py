"""OpenIllumination (Liu et al. 2023): real objects in a light stage, 48 cameras, the same views
under 13 patterns of lights, or one light at a time.

    lighting_patterns/<object>/Lights/<pattern>/raw_undistorted/<camera>.JPG
    lighting_patterns/<object>/output/obj_masks/<camera>.png, com_masks/<camera>.png
    transforms_alignz_{train,test}.json: in output/, beside the object, or above it
    lighting_patterns/<object>/output/transforms_{train,val,test}.json: without a vertical axis

Facts, from the set's card (huggingface.co/datasets/OpenIllumination/OpenIllumination) and
github.com/oppo-us-research/OpenIlluminationCapture. `frames` is an object by the camera's name,
with transform_matrix, camera_angle_x (of the whole width, radians) and calib_imgw. Masks hold 0 and
1: com_masks, the object and its support, are for training, obj_masks for scores. Pictures are the
cameras' JPEGs. The card calls the poses OpenCV's and the set's TensoIR reads them so; the set's
InvRender turns them as if they were OpenGL's. Here the cameras decide: all must look at the point
that their axes meet in. Maps of the patterns are not part of the set: give them with --lights, as
the set's TensoIR reads them, <pattern>.hdr, Z-up as `blender_uv`.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pydantic import TypeAdapter, ValidationError

from benchmarks.layouts.content import OWN_FILE, WHOLE_SET, Content, Options, Shot, needed, spaced
from benchmarks.layouts.lit import under_maps
from benchmarks.layouts.maps import blender_light, map_file
from pipeline.base.errors import InputError
from pipeline.base.files import read_json
from pipeline.geometry.cameras import OPENCV_FROM_OPENGL
from pipeline.photos.transforms_file import Frame

PATTERN = "013"  # which all loaders of the set's own comparison take
ALIGNED = "transforms_alignz_{}.json"
SUFFIXES = (".JPG", ".jpg", ".png")
CURE = "give the folder of one object, with Lights/ and output/"


@dataclass(frozen=True)
class Camera:
    """pose: camera to world (4, 4), with the file's axes or OpenGL's; angle: horizontal field of
    view, radians.
    """

    name: str
    pose: np.ndarray
    angle: float


def camera_files(folder: Path, splits: tuple[str, str]) -> dict[str, Path]:
    """The cameras by split, from one place: those with a vertical axis first, which are called
    ALIGNED. Raises InputError where no place has both.
    """
    above = folder.parent
    aligned = [folder / "output", folder, above, above / "others", above.parent / "others"]
    choices = [{s: place / ALIGNED.format(s) for s in splits} for place in aligned]
    choices.append({s: folder / "output" / f"transforms_{s}.json" for s in splits})
    found = next((c for c in choices if all(file.exists() for file in c.values())), None)
    if found is None:
        names = " and ".join(ALIGNED.format(s) for s in splits)
        raise InputError(
            f"{names} are not together in output/, beside the object or above it, "
            f"and output/ has no transforms of its own",
            folder,
            "put both files of the set's folder others/ into output/",
        )
    return found


def read_cameras(file: Path) -> list[Camera]:
    """Cameras with the file's own axes. Raises InputError naming key and fact."""
    data = read_json(file)
    try:
        frames = TypeAdapter(dict[str, Frame]).validate_python(
            data.get("frames") if isinstance(data, dict) else None
        )
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in ("frames", *first["loc"]))
        raise InputError(f"{key}: {first['msg']}", file, OWN_FILE) from error
    if not frames:
        raise InputError("it has no frames", file, OWN_FILE)

    found = []
    for name, frame in frames.items():
        if frame.camera_angle_x is None:
            raise InputError(f"frame '{name}' has no camera_angle_x", file, OWN_FILE)
        found.append(Camera(name, frame.camera_to_world(file), frame.camera_angle_x))
    return found


def meeting_point(poses: list[np.ndarray]) -> np.ndarray:
    """The point (3,) nearest to all optical axes, in least squares."""
    across = [np.eye(3) - np.outer(p[:3, 2], p[:3, 2]) for p in poses]
    along = sum(a @ p[:3, 3] for a, p in zip(across, poses))
    return np.linalg.lstsq(np.sum(across, 0), along, rcond=None)[0]


def look_along_z(poses: list[np.ndarray], file: Path) -> bool:
    """Whether cameras look along their own +z (OpenCV), not -z (OpenGL): whether the point that
    their axes meet in lies there. Raises InputError where they do not agree.
    """
    point = meeting_point(poses)
    ahead = [bool((point - p[:3, 3]) @ p[:3, 2] > 0) for p in poses]
    if len(set(ahead)) > 1:
        raise InputError(
            f"{sum(ahead)} of {len(ahead)} cameras look along +z and the others along -z at what "
            "they have in common",
            file,
            OWN_FILE,
        )
    return ahead[0]


def picture_of(folder: Path, pattern: str, camera: str) -> Path:
    """A camera's picture under a pattern. Raises InputError."""
    below = folder / "Lights" / pattern / "raw_undistorted"
    places = [below / f"{camera}{suffix}" for suffix in SUFFIXES]
    found = next((place for place in places if place.exists()), None)
    if found is None:
        raise InputError("there is no picture of this camera", places[0], WHOLE_SET)
    return found


def shots(
    folder: Path, split: str, pattern: str, masks: str, cameras: list[Camera], turn: np.ndarray
) -> list[Shot]:
    """Views of a split under a pattern, with the masks of output/<masks>. turn: from OpenGL's axes
    to the cameras' (4, 4). Raises InputError.
    """
    found = []
    for camera in cameras:
        mask = needed(folder / "output" / masks / f"{camera.name}.png", "mask", WHOLE_SET)
        photo = picture_of(folder, pattern, camera.name)
        found.append(Shot(f"{split}_{camera.name}", photo, camera.pose @ turn, camera.angle, mask))
    return found


def read(folder: Path, options: Options) -> Content:
    """Raises InputError naming what the folder lacks."""
    lights = needed(folder / "Lights", "folder Lights", CURE)
    patterns = sorted(entry.name for entry in lights.iterdir() if entry.is_dir())
    own = options.light or PATTERN
    if own not in patterns:
        known = ", ".join(patterns) or "none"
        raise InputError(f"there is no pattern {own}", lights, f"choose with --light of: {known}")

    held_out = options.held_out
    files = camera_files(folder, ("train", held_out))
    cameras = {split: read_cameras(file) for split, file in files.items()}
    poses = [camera.pose for split in cameras.values() for camera in split]
    opencv = look_along_z(poses, files["train"])
    turn = OPENCV_FROM_OPENGL if opencv else np.eye(4)
    axes = "OpenCV" if opencv else "OpenGL"
    notes = [f"cameras of {files['train'].name}, whose axes are {axes}'s"]
    if "alignz" not in files["train"].name:
        notes.append("these cameras have no vertical axis: the asset stands as they do")

    some = spaced(cameras["train"], options.train)
    train = shots(folder, "train", own, "com_masks", some, turn)
    some = spaced(cameras[held_out], options.test)
    test = shots(folder, held_out, own, "obj_masks", some, turn)

    lit = lambda shot, pattern: picture_of(folder, pattern, shot.photo.stem)
    others = [pattern for pattern in patterns if pattern != own]
    relit, more = under_maps(others, test, lit, lights, options)
    file = map_file(own, options)
    light = None if file is None else blender_light(file, 1.0, options.light_rows)
    if light is None:
        notes.append(f"pattern {own} has no map in --lights: the light is not scored")
    notes.append("the set has no base colour, roughness or metallic")
    return Content(train, test, light, relit, notes + more)
