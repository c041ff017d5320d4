"""Which files of a scene's folder are photos and masks, how photos are called, and which files are
not used.

A photo's name is its path below `images/` (or below the scene folder) without suffix, joined by
"_".
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path

from pipeline.base.errors import InputError
from pipeline.photos.colmap_model import model_folder
from pipeline.photos.decode import SUFFIXES
from pipeline.photos.given_masks import mask_file
from pipeline.photos.transforms_file import read_transforms_file

CAMERA_FILES = ("transforms.json", "transforms_train.json")
RAW = (".dng", ".cr2", ".cr3", ".nef", ".arw", ".orf", ".raf", ".rw2", ".pef", ".srw")
VIDEO = (".mp4", ".mov", ".avi", ".mkv", ".m4v", ".webm")
OTHER_PICTURES = (".webp", ".avif", ".gif", ".bmp", ".jp2", ".jxl", ".hdr", ".psd", ".tga", ".ppm")
NOT_READ = (
    dict.fromkeys(RAW, "raw file: develop it to a 16-bit TIFF")
    | dict.fromkeys(VIDEO, "video: extract its frames as JPEG")
    | dict.fromkeys(OTHER_PICTURES, "format that is not read: save it as PNG, JPEG or TIFF")
)
LONGEST_NAME = 235  # bytes: file systems take 255, and a file being written is called longer
OTHER_MESHES = (".glb", ".gltf", ".fbx", ".stl", ".dae", ".usd", ".usdz", ".usda", ".blend")
NO_MESH = "mesh of a format that is not read: export it as mesh.ply or mesh.obj"
NOT_NAMED = "photo that the transforms file does not name"
NO_PHOTO = "mask whose name matches no photo's: call it <stem of the photo>.png"


def camera_file(scene: Path) -> Path | None:
    """The scene's transforms file, if it has one."""
    return next((scene / name for name in CAMERA_FILES if (scene / name).exists()), None)


def cameras_given(scene: Path) -> bool:
    """Whether the scene has cameras, which name their photos: those that are named are all kept."""
    return camera_file(scene) is not None or model_folder(scene) is not None


def path_in_scene(scene: Path, name: str, file: Path) -> Path:
    """The path below `scene` that `file` (a transforms file) calls `name`, relative to the scene or
    absolute. Raises InputError for a name that leaves the scene's folder.

    `..` is undone in the text, before the disk is asked, so that what is opened is what was
    checked. Symbolic links are not resolved: those in a scene's folder, say images/ on another
    disk, are the user's own and keep working.
    """
    for top in (os.path.abspath(scene), os.path.realpath(scene)):
        full = os.path.normpath(os.path.join(top, name))
        if full.startswith(os.path.join(top, "")):
            return scene / os.path.relpath(full, top)

    raise InputError(
        f"the photo '{name}' lies outside the scene's folder",
        file,
        f"move the photo into {scene} and correct its path",
    )


def is_there(path: Path) -> bool:
    """Whether a file exists; one whose name is longer than file systems take does not."""
    return os.path.exists(path)  # Path.exists raises OSError for such a name


def named_frames(scene: Path, file: Path) -> list[Path]:
    """Photos that a transforms file names (suffix may be missing). A missing photo is an
    InputError.
    """
    frames = read_transforms_file(file).frames
    stems = [path_in_scene(scene, frame.file_path, file) for frame in frames]
    out: list[Path] = []
    missing: list[Path] = []
    for stem in stems:
        found = (
            stem
            if stem.suffix.lower() in SUFFIXES
            else next((p for s in SUFFIXES if is_there(p := stem.with_name(stem.name + s))), stem)
        )
        (out if is_there(found) else missing).append(found)
    if missing:
        raise InputError(
            f"{len(missing)} of {len(stems)} frames name photos that are not there, first "
            f"{missing[0].relative_to(scene)}",
            file,
            "add the photos or remove those frames",
        )
    return out


def photo_name(scene: Path, path: Path) -> str:
    """Name of a photo below `scene`; only a known image suffix is taken off, so that
    `frame.001.png` and `frame.002.png` differ.
    """
    relative = path.relative_to(scene)
    parts = (relative.with_suffix("") if relative.suffix.lower() in SUFFIXES else relative).parts
    return "_".join(parts[1:] if parts[0] == "images" and len(parts) > 1 else parts)


def find_photos(scene: Path) -> list[tuple[str, Path, str]]:
    """(name, path, split) of every photo; split "test" for frames of transforms_test.json."""
    if not scene.is_dir():
        raise InputError(
            "the scene folder does not exist", scene, "correct `photos:` in the configuration"
        )
    cameras, out = camera_file(scene), []
    if cameras:
        out = [(photo_name(scene, p), p, "fit") for p in named_frames(scene, cameras)]
        test = scene / "transforms_test.json"
        if test.exists():
            out += [(photo_name(scene, p), p, "test") for p in named_frames(scene, test)]
    else:
        folder = scene / "images" if (scene / "images").is_dir() else scene
        paths = [p for p in _visible_files(folder) if p.suffix.lower() in SUFFIXES]
        out = [
            (photo_name(scene, p), p, "fit")
            for p in paths
            if "masks" not in p.relative_to(folder).parts
        ]
    if not out:
        raise InputError(
            "no photos found",
            scene,
            "put .jpg, .heic, .png, .tif or .exr files into its folder images/",
        )
    if len(out) < 3:
        raise InputError(
            f"{len(out)} photo(s) found; at least 3 are needed, 20-60 around the object are good",
            scene,
            "take more photos with about 80 % overlap",
        )
    names = [n for n, _, _ in out]
    twice = sorted({n for n in names if names.count(n) > 1})
    if twice:
        files = [p.relative_to(scene).as_posix() for n, p, _ in out if n == twice[0]]
        raise InputError(
            f"two photos, {' and '.join(files[:2])}, are called '{twice[0]}'",
            scene,
            "give every photo a name of its own",
        )
    for name, path, _ in out:
        _check_name(name, path)
    return out


def _check_name(name: str, path: Path) -> None:
    """InputError for a name that cannot be a file's in work/, or written down."""
    try:
        length = len(f"{name}.png".encode())
    except UnicodeEncodeError as error:
        raise InputError(
            f"the name of a photo, {path.name!r}, is not UTF-8", path.parent, "rename it"
        ) from error
    if length > LONGEST_NAME:
        raise InputError(
            f"its name, with its folders {length} bytes, is over {LONGEST_NAME}",
            path,
            "give it or its folders shorter names",
        )


def left_out(scene: Path, found: list[tuple[str, Path, str]]) -> dict[str, list[str]]:
    """Pictures and masks of the scene's folder that are not used: reason -> paths below `scene`.
    Other files (notes, cameras, thumbnails' data) are nobody's photos and not listed.
    """
    photos = [path for _, path, _ in found]
    used = {path.resolve() for path in photos}
    folder = scene / "images" if (scene / "images").is_dir() else scene
    out: dict[str, list[str]] = {}
    for file in _visible_files(folder):
        kind = file.suffix.lower()
        unnamed = kind in SUFFIXES and file.resolve() not in used and folder != scene
        reason = NOT_NAMED if unnamed else NOT_READ.get(kind)
        if reason and "masks" not in file.relative_to(folder).parts:
            out.setdefault(reason, []).append(file.relative_to(scene).as_posix())

    masks = {mask for photo in photos if (mask := mask_file(scene, photo))}
    pictures = {*SUFFIXES, *NOT_READ}
    files = (f for f in _visible_files(scene / "masks") if f.suffix.lower() in pictures)
    lone = [f for f in files if f not in masks]
    if lone:
        out[NO_PHOTO] = [f.relative_to(scene).as_posix() for f in lone]
    meshes = [f.name for f in sorted(scene.glob("mesh.*")) if f.suffix.lower() in OTHER_MESHES]
    if meshes:
        out[NO_MESH] = meshes
    return out


def _visible_files(folder: Path) -> Iterable[Path]:
    """All files below a folder, sorted, without hidden ones and those in hidden folders; none if
    there is no such folder. Links that lead nowhere are among them.
    """
    return (f for f in sorted(folder.rglob("*")) if not f.is_dir() and not _hidden(f, folder))


def _hidden(file: Path, folder: Path) -> bool:
    """Whether the file, or a folder between it and `folder`, has a name that begins with a dot."""
    return any(part.startswith(".") for part in file.relative_to(folder).parts)
