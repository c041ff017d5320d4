"""A photo's file as upright pixels, what their numbers mean, and the facts of its EXIF.

Pixels stay as the file holds them (8 or 16 bits) until they are scaled down: a photo of 48
megapixels is 150 MB that way, and 600 MB as floats.
"""

from __future__ import annotations

import io
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import cv2
import numpy as np
from PIL import Image, ImageCms

from pipeline.base.errors import InputError
from pipeline.photos import colour_space
from pipeline.photos.colour_space import LINEAR, SRGB, ColourSpace, UnknownProfile
from pipeline.photos.decode_exr import decode_exr

HEIF = (".heic", ".heif", ".hif")
SUFFIXES = (".jpg", ".jpeg", ".png", ".tif", ".tiff", ".exr", *HEIF)
HEIF_BRANDS = (b"heic", b"heix", b"hevc", b"hevx", b"heim", b"heis", b"mif1", b"msf1")
LEAST_SIDE, MOST_SIDE = 8, 16384  # pixels
# `check_size` refuses by itself, and by sides
Image.MAX_IMAGE_PIXELS = None
CURE = "copy it again from the camera, or remove it"
TIFF_CURE = "save it as a TIFF of 8 or 16 bits, a linear picture as EXR"
ORIENTATION = 0x0112
EXIF_IFD = 0x8769
INTEROPERABILITY_IFD = 0xA005
MOST_OF_EXIF = 1e9  # larger numbers of a photo's EXIF, and those below 1 over it, are none
COLOUR_SPACE = 0xA001  # of EXIF: 1 sRGB, 2 Adobe RGB (not in the standard), 65535 other
ORIENTED: dict[int, Callable[[np.ndarray], np.ndarray]] = {
    2: lambda a: a[:, ::-1],
    3: lambda a: a[::-1, ::-1],
    4: lambda a: a[::-1],
    5: lambda a: a.swapaxes(0, 1),
    6: lambda a: np.rot90(a, 3),
    7: lambda a: np.rot90(a, 2).swapaxes(0, 1),
    8: lambda a: np.rot90(a, 1),
}
# pycolmap brings its own libpng and zlib: if it is loaded first, OpenCV binds to a mixture of both
# and aborts at its first PNG. One round trip here, before any stage loads pycolmap, binds OpenCV to
# its own.
cv2.imdecode(cv2.imencode(".png", np.zeros((2, 2), np.uint16))[1], cv2.IMREAD_UNCHANGED)


@dataclass
class Photo:
    """A decoded file. pixels (h, w, 3 or 4), upright: uint8 or uint16 of full scale, encoded as
    `space` says; or float32, linear (EXR). facts: from EXIF, and under `note` what was converted.
    """

    pixels: np.ndarray
    space: ColourSpace
    facts: dict

    @property
    def full_scale(self) -> float:
        """The number that stands for 1."""
        integers = np.issubdtype(self.pixels.dtype, np.integer)
        return float(np.iinfo(self.pixels.dtype).max) if integers else 1.0


def decode(path: Path, profiles: bool = True) -> Photo:
    """Read a photo. profiles: whether colour profiles count; without, all but EXR is sRGB.

    Raises InputError naming the file if it is damaged, holds NaN, or is encoded in a way that does
    not lead back to light.
    """
    try:
        data = path.read_bytes()
        kind = kind_of(data)
        if kind == "exr":
            pixels, notes = decode_exr(path)
            return Photo(pixels, LINEAR, {"note": ", ".join(notes)} if notes else {})
        if kind == "heif":
            return _decode_heif(data, profiles)
        return _decode_common(path, data, profiles)
    except UnknownProfile as error:
        raise InputError(
            f"its colours cannot be converted: {error}",
            path,
            "export it as sRGB, or set `capture: {encoding: srgb}` to read it as if it were",
        ) from error
    except (
        OSError,
        SyntaxError,
        ValueError,
        EOFError,
        ImageCms.PyCMSError,
        Image.DecompressionBombError,
    ) as error:
        raise InputError(
            f"the photo cannot be read ({error})",
            path,
            TIFF_CURE if path.suffix.lower().startswith(".tif") else CURE,
        ) from error


def kind_of(data: bytes) -> str:
    """ "exr", "heif" or "common", by a file's first bytes: names are often wrong. ValueError for an
    empty file.
    """
    if not data:
        raise ValueError("the file is empty")
    if data.startswith(b"\x76\x2f\x31\x01"):
        return "exr"
    return "heif" if data[4:8] == b"ftyp" and data[8:12] in HEIF_BRANDS else "common"


def check_size(width: int, height: int) -> None:
    """ValueError for pictures too small to tell anything and too large to be held."""
    if min(width, height) < LEAST_SIDE:
        raise ValueError(f"{width}x{height} pixels, at least {LEAST_SIDE} along a side are needed")
    if max(width, height) > MOST_SIDE:
        raise ValueError(f"{width}x{height} pixels, at most {MOST_SIDE} along a side are read")


def _decode_common(path: Path, data: bytes, profiles: bool) -> Photo:
    """JPEG, PNG and TIFF. Pillow and OpenCV both turn a TIFF by themselves and neither a PNG;
    Pillow drops the tag where it has turned, so it is read after `load`.
    """
    with Image.open(io.BytesIO(data)) as image:
        check_size(*image.size)
        image.load()  # Pillow refuses truncated files, OpenCV would not
        tags = image.getexif()
        facts = _exif_facts(tags)
        space = SRGB
        unknown = None
        if profiles:
            try:
                space = _space(image.info.get("icc_profile"), tags)
            except UnknownProfile as error:
                unknown = error

        deep = None
        if not path.suffix.lower().startswith(".jp"):
            deep = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
        if deep is not None and deep.dtype == np.uint16:
            if unknown:
                raise unknown
            pixels = deep[..., [2, 1, 0, 3][: deep.shape[2]]] if deep.ndim == 3 else deep
            notes = ["16 bit"]
        elif unknown or image.mode in ("CMYK", "LAB"):
            pixels, note = _by_colour_engine(image, unknown)
            space = SRGB
            notes = [note]
        else:
            pixels = _rgb(image)
            notes = []

    if space is not SRGB:
        notes.append(space.name)
    return _upright(pixels, space, facts, notes, tags.get(ORIENTATION, 1))


def _decode_heif(data: bytes, profiles: bool) -> Photo:
    """HEIC and HEIF, 8 to 12 bits. libheif turns the picture as its container says; the tag of its
    EXIF repeats that and is not applied again.
    """
    import pi_heif

    try:
        image = pi_heif.open_heif(data, convert_hdr_to_8bit=False)
        pixels = np.array(image)  # a copy: libheif's memory goes with `image`
    except RuntimeError as error:  # where a damaged file asks for more than libheif allows
        raise ValueError(str(error)) from error
    except IndexError as error:
        raise ValueError("it holds no picture") from error

    tags = Image.Exif()
    if image.info.get("exif"):
        tags.load(image.info["exif"])
    notes = [] if pixels.dtype == np.uint8 else [f"{image.info['bit_depth']} bit"]
    space = SRGB
    if profiles:
        points = image.info.get("nclx_profile")
        if image.info.get("icc_profile"):
            space = _of_icc(image.info["icc_profile"])
        elif points:
            space = colour_space.of_code_points(
                points["color_primaries"], points["transfer_characteristics"]
            )
    if space is not SRGB:
        notes.append(space.name)
    return _upright(pixels, space, _exif_facts(tags), notes, 1)


def _upright(
    pixels: np.ndarray, space: ColourSpace, facts: dict, notes: list[str], orientation: int
) -> Photo:
    """Three channels or four, turned as EXIF says. 0 and what the standard does not know mean as it
    is.
    """
    if pixels.ndim == 2:
        pixels = np.repeat(pixels[..., None], 3, -1)
    elif pixels.shape[2] == 2:
        pixels = pixels[..., [0, 0, 0, 1]]
    turned = ORIENTED.get(orientation, lambda a: a)(pixels)
    note = {"note": ", ".join(notes)} if notes else {}
    return Photo(np.ascontiguousarray(turned), space, facts | note)


def _space(profile: bytes | None, tags: Image.Exif) -> ColourSpace:
    """Colour space by the embedded profile, else by EXIF, else sRGB."""
    if profile:
        return _of_icc(profile)

    marked = tags.get_ifd(EXIF_IFD).get(COLOUR_SPACE)
    index = str(tags.get_ifd(INTEROPERABILITY_IFD).get(1, "")).strip("\0 ")
    if marked == 2 or index == "R03":
        return colour_space.adobe_rgb()
    return SRGB


def _of_icc(profile: bytes) -> ColourSpace:
    try:
        return colour_space.of_icc(profile)
    except (OSError, ImageCms.PyCMSError) as error:
        raise UnknownProfile(f"a damaged profile ({error})") from error


def _rgb(image: Image.Image) -> np.ndarray:
    """A Pillow image as uint8 (h, w, 3 or 4)."""
    if image.mode in ("F", "I"):
        raise ValueError(
            f"32 bits per channel (Pillow mode {image.mode}): save linear pictures as EXR"
        )
    alpha = image.mode in ("RGBA", "LA", "PA") or "transparency" in image.info
    return np.asarray(image.convert("RGBA" if alpha else "RGB"))


def _by_colour_engine(image: Image.Image, unknown: UnknownProfile | None) -> tuple[np.ndarray, str]:
    """A picture whose profile holds tables, as sRGB of 8 bits by Little CMS; and a note."""
    target = ImageCms.createProfile("sRGB")
    if image.mode == "LAB":
        source = ImageCms.ImageCmsProfile(ImageCms.createProfile("LAB"))
        converted = ImageCms.profileToProfile(image, source, target, outputMode="RGB")
        return np.asarray(cast(Image.Image, converted)), "CIELAB"

    profile = image.info.get("icc_profile")
    if not profile:
        return np.asarray(image.convert("RGB")), "CMYK without a profile, by the plain formula"
    if image.mode not in ("CMYK", "RGB", "L"):
        raise unknown or UnknownProfile(f"a profile with a picture of mode {image.mode}")

    try:
        source = ImageCms.ImageCmsProfile(io.BytesIO(profile))
    except (OSError, ImageCms.PyCMSError) as error:
        raise unknown or UnknownProfile(f"a damaged profile ({error})") from error
    converted = ImageCms.profileToProfile(image, source, target, outputMode="RGB")
    return np.asarray(cast(Image.Image, converted)), f"{image.mode} by its ICC profile's tables"


def _exif_facts(tags: Image.Exif) -> dict:
    """Exposure and focal length from EXIF; missing or zero values are left out."""
    ifd = tags.get_ifd(EXIF_IFD)
    facts = {
        "make": str(tags.get(0x010F, "")).strip("\0 "),
        "model": str(tags.get(0x0110, "")).strip("\0 "),
        "focal_35mm": _number(ifd.get(0xA405)),
        "focal_mm": _number(ifd.get(0x920A)),
        "time": _number(ifd.get(0x829A)),
        "f_number": _number(ifd.get(0x829D)),
        "iso": _number(ifd.get(0x8827)),
    }
    return {k: v for k, v in facts.items() if v}


def _number(value: Any) -> float | None:
    """A positive number of EXIF, the first of several; None for what is none, or is beyond what any
    camera can mean.
    """
    first = value[0] if isinstance(value, tuple) and value else value
    try:
        number = float(first)
    except (TypeError, ValueError, ZeroDivisionError):
        return None
    return number if 1 / MOST_OF_EXIF < number < MOST_OF_EXIF else None
