"""Stanford-ORB (Kuang et al. 2023), the representation "blender": real photos of an object in one
scene, its held-out views, and views of the same object in other scenes.

    blender_LDR or blender_HDR/<object>_scene00x/   (blender_format_LDR, _HDR: the same)
        train/%04d.{png,exr}  train_mask/%04d.png  test/...  test_mask/...
        transforms_train.json  transforms_test.json  transforms_novel.json
    ground_truth/<object>_scene00x/  env_map/%04d.exr  pseudo_gt_albedo/%04d.png

Facts, from README.md, orb/datasets/mymethod.py, orb/utils/ and issue 9 of
github.com/StanfordORB/Stanford-ORB. Poses are as NeRF-synthetic's. A frame of transforms_novel.json
has a `scene_name`; its picture lies in that scene's folder, and its pose is in the world of this
one. env_map/<view>.exr is in the axes of that view's camera (`skylibs_uv`; orb/utils/env_map.py),
so it turns with the camera and there is one a view. HDR pictures are linear radiance, LDR ones
their sRGB; pseudo albedo is sRGB. Scores are published at 512 of 2048 pixels (--side 512), against
HDR. Depth, normals and the scanned mesh are read by no score of ours.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from benchmarks.layouts.content import (
    OWN_FILE,
    WHOLE_SET,
    Content,
    Options,
    Relit,
    Shot,
    chosen_names,
    needed,
    spaced,
)
from benchmarks.layouts.maps import camera_light
from benchmarks.layouts.transforms import angle_of, picture_of, read_cameras
from pipeline.base.errors import InputError
from pipeline.base.files import read_json
from pipeline.photos.transforms_file import Frame, Transforms

CURE = "give blender_LDR/<object>_scene00x or blender_HDR/<object>_scene00x of the set"
SUFFIXES = (".exr", ".png")
NO_FACTOR = (
    "photos and maps of Stanford-ORB share no scale: compare relit views by the score with one "
    "factor per channel, which its own has too"
)


def in_hdr(picture: Path, scene: Path) -> Path | None:
    """The same picture in linear radiance, from blender_HDR beside blender_LDR."""
    if picture.suffix == ".exr":
        return None
    folder = scene.parent.with_name(scene.parent.name.replace("LDR", "HDR"))
    file = (folder / scene.name / picture.relative_to(scene)).with_suffix(".exr")
    return file if file.exists() else None


def shot_of(scene: Path, frame: Frame, cameras: Transforms, file: Path) -> Shot:
    """A frame of `file` whose picture lies in the folder `scene`. Raises InputError."""
    photo = picture_of(scene, frame.file_path, file, SUFFIXES)
    folder = photo.parent.with_name(f"{photo.parent.name}_mask")
    mask = needed(folder / f"{photo.stem}.png", "mask", WHOLE_SET)
    name = f"{photo.parent.name}_{photo.stem}"
    pose, angle = frame.camera_to_world(file), angle_of(frame, cameras, file)
    return Shot(name, photo, pose, angle, mask, in_hdr(photo, scene))


def shots(scene: Path, split: str, most: int | None) -> list[Shot]:
    """Views of transforms_<split>.json. Raises InputError."""
    file, cameras = read_cameras(scene, split, CURE)
    return [shot_of(scene, frame, cameras, file) for frame in spaced(cameras.frames, most)]


def ground_truth(scene: Path) -> Path:
    """The set's folder of true maps for a scene of blender_LDR or blender_HDR."""
    return scene.parent.parent / "ground_truth" / scene.name


def with_albedo(test: list[Shot], scene: Path) -> tuple[list[Shot], list[str]]:
    """The same views with their base colour where all have it, else with a note."""
    folder = ground_truth(scene) / "pseudo_gt_albedo"
    files = [folder / f"{shot.photo.stem}.png" for shot in test]
    if not all(file.exists() for file in files):
        return test, ["not every view has its pseudo_gt_albedo: base colour is not scored"]
    return [replace(s, albedo=file, albedo_srgb=True) for s, file in zip(test, files)], []


def of_scenes(file: Path, cameras: Transforms) -> dict[str, list[Frame]]:
    """Frames of transforms_novel.json by the scene that each lies in. Raises InputError."""
    names = [entry.get("scene_name") for entry in read_json(file)["frames"]]
    if not all(isinstance(name, str) for name in names):
        raise InputError("a frame has no scene_name", file, OWN_FILE)
    found: dict[str, list[Frame]] = {}
    for name, frame in zip(names, cameras.frames):
        found.setdefault(name, []).append(frame)
    return found


def novel(scene: Path, options: Options) -> tuple[list[Relit], list[str]]:
    """Views in other scenes, each under the map of its own camera, and notes about those that are
    not there. Raises InputError.
    """
    if not (scene / "transforms_novel.json").exists():
        return [], ["there is no transforms_novel.json: no view in another scene"]
    file, cameras = read_cameras(scene, "novel", CURE)
    frames = of_scenes(file, cameras)

    found = []
    notes = []
    for name in chosen_names(list(frames), options, file):
        other = scene.parent / name
        maps = ground_truth(other) / "env_map"
        if not (other.is_dir() and maps.is_dir()):
            notes.append(f"views in {name} are left out: its pictures or its env_map are not there")
            continue
        for frame in spaced(frames[name], options.test):
            shot = shot_of(other, frame, cameras, file)
            of_view = needed(maps / f"{shot.photo.stem}.exr", "map of this view", WHOLE_SET)
            light = camera_light(of_view, shot.pose, options.light_rows)
            found.append(Relit(f"{name}_{shot.photo.stem}", light, [shot], own=True))
    return found, notes


def read(folder: Path, options: Options) -> Content:
    """Raises InputError naming what the folder lacks."""
    train = shots(folder, "train", options.train)
    test, notes = with_albedo(shots(folder, options.held_out, options.test), folder)
    relit, more = novel(folder, options)
    notes += more

    first = test[0]
    file = ground_truth(folder) / "env_map" / f"{first.photo.stem}.exr"
    light = camera_light(file, first.pose, options.light_rows) if file.exists() else None
    if light is None:
        notes.append("there is no env_map of the held-out views: the light is not scored")
    else:
        notes.append(f"the light is the map of one view, {first.name}: the set has one a view")
    if any(shot.photo.suffix != ".exr" and shot.radiance is None for shot in test):
        notes.append("there is no blender_HDR beside: held-out views are compared with 8 bits")
    return Content(train, test, light, relit, [*notes, NO_FACTOR])
