"""Masks that the user gave: which file is whose, and what it says."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
from PIL import Image, ImageOps

from pipeline.base.errors import InputError

MASK_SUFFIXES = (".png", ".PNG", ".jpg", ".JPG", ".jpeg")
WHITE = 128  # of 255, from which a pixel is the object
DARK, LIGHT = 32, 223  # between them a pixel is neither
MOST_GREY = 0.25  # share of such pixels in a mask; hair and motion blur leave less


def mask_file(scene: Path, photo: Path) -> Path | None:
    """The mask that the user gave for a photo, if there is one, in the scene's folder masks/: at
    the photo's own path below images/; or called by that path, joined by "_"; or by its stem. All
    with or without the photo's own suffix.
    """
    below = photo.relative_to(scene).parts
    below = below[1:] if below[0] == "images" and len(below) > 1 else below
    folder = scene / "masks"
    places = [folder.joinpath(*below), folder / "_".join(below), folder / photo.name]
    stems = [stem for place in places for stem in (place.with_suffix(""), place)]
    candidates = (stem.with_name(stem.name + end) for stem in stems for end in MASK_SUFFIXES)
    return next((file for file in candidates if file.exists()), None)


def check_owners(scene: Path, photos: list[Path]) -> None:
    """InputError for a mask that is the mask of several photos by its name."""
    masks = [mask_file(scene, photo) for photo in photos]
    for mask, count in Counter(mask for mask in masks if mask is not None).items():
        if count > 1:
            owners = [p.relative_to(scene) for p, m in zip(photos, masks) if m == mask]
            raise InputError(
                f"it may be the mask of {' and of '.join(o.as_posix() for o in owners)}",
                mask,
                "put masks into folders like those of the photos",
            )


def read_mask(file: Path, size: tuple[int, int]) -> np.ndarray:
    """A mask, uint8 (h, w), upright. `size`: its photo's width and height. One that is all of one
    colour and has an alpha channel has the object there.

    Raises InputError if it cannot be read, has another size, is all black, or no mask at all.
    """
    try:
        with Image.open(file) as image:
            # before its pixels are read: a damaged head may claim more than memory holds
            if sorted(image.size) != sorted(size):
                raise _of_another_size(image.size, size, file)
            mask = _grey(ImageOps.exif_transpose(image))
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        raise InputError(
            f"the mask cannot be read ({error})", file, "save it again as PNG"
        ) from error
    if mask.shape != size[::-1]:
        raise _of_another_size(mask.shape[::-1], size, file)
    if mask.max() < WHITE:
        raise InputError(
            f"the mask is all black, or nearly: its brightest pixel is {mask.max()} of 255",
            file,
            "paint the object white (255), or delete the mask",
        )
    grey = float(((mask > DARK) & (mask < LIGHT)).mean())
    if grey > MOST_GREY:
        raise InputError(
            f"{100 * grey:.0f} % of it is grey: this is no mask",
            file,
            "save the mask there, white where the object is and black elsewhere",
        )
    return mask


def _of_another_size(own: tuple[int, ...], size: tuple[int, int], file: Path) -> InputError:
    return InputError(
        f"the mask is {own[0]}x{own[1]}, its photo {size[0]}x{size[1]}",
        file,
        "save the mask at the photo's size",
    )


def _grey(image: Image.Image) -> np.ndarray:
    """Brightness of a picture, uint8 (h, w); of one colour alone, its alpha."""
    if image.mode.startswith("I"):  # 16 bits
        return (np.asarray(image).astype(np.int64) // 257).clip(0, 255).astype(np.uint8)
    if image.mode in ("LA", "RGBA", "PA"):
        pixels = np.asarray(image.convert("RGBA"))
        colors, alpha = pixels[..., :3], pixels[..., 3]
        if (colors == colors[0, 0]).all() and alpha.min() < alpha.max():
            return alpha
    return np.asarray(image.convert("L"))
