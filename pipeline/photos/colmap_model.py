"""A COLMAP model that comes with the photos: found, read and checked."""

from __future__ import annotations

import struct
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING

from pipeline.base.errors import InputError

if TYPE_CHECKING:
    import pycolmap

# file -> least bytes that an entry of it takes: a damaged count would ask for all memory
LEAST_BYTES = {"cameras": 24, "images": 64, "points3D": 43}
# file -> bytes of an item of the list that ends its entries: a keypoint, a sighting
ITEM_BYTES = {"images": 24, "points3D": 8}
AGAIN = "export the model again: cameras, images and points3D, all .bin or all .txt"


def model_folder(scene: Path) -> Path | None:
    """sparse/0 of a scene, or sparse/ with the files in it; None where there is no model."""
    sparse = scene / "sparse"
    if (sparse / "0").is_dir():
        return sparse / "0"
    return sparse if any((sparse / f"cameras.{end}").exists() for end in ("bin", "txt")) else None


def read_model(folder: Path) -> pycolmap.Reconstruction:
    """The model in `folder`. Raises InputError for a missing, damaged or empty one."""
    import pycolmap

    for name, least in LEAST_BYTES.items():
        _check_count(folder / f"{name}.bin", least)
    for name, item in ITEM_BYTES.items():
        _check_lists(folder / f"{name}.bin", LEAST_BYTES[name], item)
    try:
        model = pycolmap.Reconstruction(folder)
    except (ValueError, RuntimeError, OSError, LookupError, MemoryError) as error:
        what = f"not a COLMAP model ({error})"
        if "VerifyParams" in str(error):
            what += ": a focal length or another number of a camera is impossible"
        raise InputError(what, folder, AGAIN) from error

    posed = sum(image.has_pose for image in model.images.values())
    if not posed:
        raise InputError(f"0 of {len(model.images)} images have a pose", folder, AGAIN)
    _check_names(model, folder)
    return model


def _check_names(model: pycolmap.Reconstruction, folder: Path) -> None:
    """InputError for an image whose name is no text."""
    for number, image in model.images.items():
        try:
            image.name  # noqa: B018  decoded where it is asked for
        except UnicodeDecodeError as error:
            raise InputError(
                f"the name of image {number} is damaged, or not in UTF-8 ({error})", folder, AGAIN
            ) from error


def _check_count(file: Path, least: int) -> None:
    """InputError for a binary file that is too short for the entries that it says it has."""
    if not file.exists():
        return
    head = file.open("rb").read(8)
    count = struct.unpack("<Q", head)[0] if len(head) == 8 else -1
    if count < 0 or 8 + count * least > file.stat().st_size:
        raise InputError(
            f"{file.name} is damaged: {file.stat().st_size} bytes are too few for what it holds",
            file.parent,
            AGAIN,
        )


def _check_lists(file: Path, fixed: int, item: int) -> None:
    """InputError for a binary file with an entry whose list says that it goes on behind the end.

    An entry is `fixed` bytes, of an image also a name that a zero ends, the list's length in 8
    bytes, and the list's items of `item` bytes each.
    """
    if not file.exists():
        return
    data = file.read_bytes()
    at = 8
    for _ in range(struct.unpack_from("<Q", data)[0]):
        at += fixed
        if file.stem == "images":
            at = data.find(b"\0", at) + 1 or len(data)
        if at + 8 <= len(data):
            at += 8 + item * struct.unpack_from("<Q", data, at)[0]
        else:
            at = len(data) + 1
        if at > len(data):
            raise InputError(
                f"{file.name} is damaged: {len(data)} bytes are too few for what it holds",
                file.parent,
                AGAIN,
            )


def names_of(photos: list[dict], model: pycolmap.Reconstruction, folder: Path) -> dict[str, str]:
    """The model's image names -> photos' names: by path below images/, or by the file's name alone.
    Raises InputError for images that are not among the photos, or fit several.
    """
    alone = Counter(Path(p["file"]).name for p in photos)
    names = {Path(p["file"]).name: p["name"] for p in photos}
    whole = {p["file"].removeprefix("images/"): p["name"] for p in photos}
    names |= whole

    of_model = sorted(image.name for image in model.images.values() if image.has_pose)
    missing = [name for name in of_model if name not in names]
    if missing:
        raise InputError(
            f"{len(missing)} of {len(model.images)} images of the model are not among the photos, "
            f"first {missing[0]}",
            folder,
            "add the photos, or remove those images from the model",
        )
    either = [name for name in of_model if name not in whole and alone[name] > 1]
    if either:
        raise InputError(
            f"the model's image {either[0]} may be {alone[either[0]]} of the photos",
            folder,
            "name images in the model with their folders, or give photos names of their own",
        )
    return names
