"""Photos, masks and base colour of a data set as linear arrays."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from benchmarks.layouts.content import Shot
from pipeline.base.errors import InputError
from pipeline.photos.capture import scaled
from pipeline.photos.colour_space import LINEAR
from pipeline.photos.decode import Photo, decode

ONE_DOWNLOAD = "use the files of one download"
HALF = 0.5  # share of a pixel that the object covers, from which the pixel is the object's


def size_at(photo: Photo, side: int | None) -> tuple[int, int]:
    """Width and height, scaled down so that the longer is at most `side`."""
    height, width = photo.pixels.shape[:2]
    factor = 1.0 if side is None else min(1.0, side / max(height, width))
    return max(1, round(width * factor)), max(1, round(height * factor))


def cover(shot: Shot, photo: Photo) -> np.ndarray:
    """Share of every pixel (h, w) that shows the object: of the mask's file, whose largest number
    is white (some sets write 0 and 1), else the photo's alpha. Raises InputError where there is
    neither.
    """
    if shot.mask is None:
        if photo.pixels.shape[2] < 4:
            raise InputError(
                "has neither a mask nor an alpha channel", shot.photo, "use the set's own files"
            )
        alpha = photo.pixels[..., 3].astype(np.float32) / np.float32(photo.full_scale)
        if alpha.max() == 0:
            raise InputError("is transparent everywhere", shot.photo, "use the set's own picture")
        return alpha

    grey = decode(shot.mask).pixels[..., 0].astype(np.float32)
    if grey.shape != photo.pixels.shape[:2]:
        own, other = grey.shape[::-1], photo.pixels.shape[1::-1]
        raise InputError(
            f"the mask is {own[0]}x{own[1]}, its photo {other[0]}x{other[1]}",
            shot.mask,
            ONE_DOWNLOAD,
        )
    if grey.max() == 0:
        raise InputError("the mask is all black", shot.mask, "use the set's own mask")
    return grey / grey.max()


def resized(values: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Means over the area of each new pixel. size: width and height."""
    same = values.shape[1::-1] == size
    return values if same else cv2.resize(values, size, interpolation=cv2.INTER_AREA)


def load(shot: Shot, side: int | None, file: Path | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Linear picture (h, w, 3), on black where the photo has an alpha channel (straight, as PNG
    has it), and the outline (h, w), bool. file: read in place of the photo, of the same size.
    """
    photo = decode(shot.photo)
    size = size_at(photo, side)
    outline = resized(cover(shot, photo), size) > HALF

    shown = photo if file is None else decode(file)
    if shown.pixels.shape[:2] != photo.pixels.shape[:2]:
        raise InputError(f"it is not of the size of {shot.photo.name}", file, ONE_DOWNLOAD)
    linear = scaled(shown, size)
    if shown.pixels.shape[2] == 4:
        alpha = shown.pixels[..., 3].astype(np.float32) / np.float32(shown.full_scale)
        linear = linear * resized(alpha, size)[..., None]
    return linear, outline


def load_albedo(shot: Shot, size: tuple[int, int]) -> np.ndarray:
    """Linear base colour (h, w, 3) of a shot that has a file of it, at that width and height.
    Raises InputError where it is of another shape.
    """
    assert shot.albedo is not None
    photo = decode(shot.albedo)
    height, width = photo.pixels.shape[:2]
    if abs(width * size[1] - height * size[0]) > max(width, height):
        raise InputError(
            f"it is {width}x{height}, its view {size[0]}x{size[1]}", shot.albedo, ONE_DOWNLOAD
        )
    if not shot.albedo_srgb:
        photo.space = LINEAR
    return scaled(photo, size)
