"""transforms_<split>.json as NeRF-synthetic has it, and the pictures that it names without their
suffixes. Stanford-ORB has the same.
"""

from __future__ import annotations

from pathlib import Path

from benchmarks.layouts.content import OWN_FILE, WHOLE_SET, needed
from pipeline.base.errors import InputError
from pipeline.photos.scene_files import path_in_scene
from pipeline.photos.transforms_file import Frame, Transforms, read_transforms_file


def read_cameras(folder: Path, split: str, cure: str) -> tuple[Path, Transforms]:
    """The file of a split and what it holds. Raises InputError where it is not there, cannot be
    read, or has no frames.
    """
    file = needed(folder / f"transforms_{split}.json", "file of cameras", cure)
    cameras = read_transforms_file(file)
    if not cameras.frames:
        raise InputError("it has no frames", file, OWN_FILE)
    return file, cameras


def angle_of(frame: Frame, cameras: Transforms, file: Path) -> float:
    """Horizontal field of view in radians, of the frame or of all. Raises InputError for none."""
    angle = frame.camera_angle_x or cameras.camera_angle_x
    if angle is None:
        raise InputError("camera_angle_x is not given", file, OWN_FILE)
    return angle


def picture_of(scene: Path, name: str, file: Path, suffixes: tuple[str, ...]) -> Path:
    """The picture that `file` calls `name`, with the first of the suffixes that it has. Raises
    InputError where it is not there, or lies outside of the folder `scene`.
    """
    stem = path_in_scene(scene, name, file)
    if stem.suffix.lower() in suffixes:
        stem = stem.with_suffix("")
    places = [stem.with_name(stem.name + suffix) for suffix in suffixes]
    found = next((place for place in places if place.exists()), None)
    if found is None:
        raise InputError(f"{file.name} names a picture that is not there", places[-1], WHOLE_SET)
    return found
