"""Colour and image files. In memory: float32 arrays (h, w, 3) or (h, w), linear Rec.709 radiance
unless said otherwise.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from pipeline.base.errors import InputError
from pipeline.base.files import atomic_path

LUMINANCE = np.array([0.2126, 0.7152, 0.0722], np.float32)  # Rec.709 primaries
LARGEST_HALF = 65504  # largest finite float16
FEWEST_IN_ROW, MOST_IN_ROW = 5, 8  # tiles of a contact sheet
FILLED = 128  # value of a contact sheet beside its pictures


def srgb_to_linear(x: np.ndarray) -> np.ndarray:
    """IEC 61966-2-1 decoding of values in [0, 1]."""
    x = np.asarray(x, np.float32)
    return np.where(x <= 0.04045, x / 12.92, ((np.maximum(x, 0) + 0.055) / 1.055) ** 2.4).astype(
        np.float32
    )


def linear_to_srgb(x: np.ndarray) -> np.ndarray:
    """IEC 61966-2-1 encoding, clipped to [0, 1]."""
    return perceived(np.clip(np.asarray(x, np.float32), 0, 1))


def perceived(x: np.ndarray) -> np.ndarray:
    """As `linear_to_srgb`, of x >= 0, with the curve going on above 1, which is white on a screen
    only.
    """
    x = np.asarray(x, np.float32)
    return np.where(
        x <= 0.0031308, 12.92 * x, 1.055 * np.maximum(x, 1e-8) ** (1 / 2.4) - 0.055
    ).astype(np.float32)


def luminance(rgb: np.ndarray) -> np.ndarray:
    """Rec.709 luminance of (..., 3)."""
    return np.asarray(rgb) @ LUMINANCE


def to_srgb8(linear: np.ndarray) -> np.ndarray:
    """Linear radiance -> 8-bit sRGB for viewing."""
    return (linear_to_srgb(linear) * 255 + 0.5).astype(np.uint8)


def full_rows(count: int) -> int:
    """How many of `count` tiles make a row, so that the last row lacks the fewest."""
    if count <= MOST_IN_ROW:
        return count
    return min(range(MOST_IN_ROW, FEWEST_IN_ROW - 1, -1), key=lambda columns: -count % columns)


def in_rows(tiles: list[np.ndarray], columns: int | None = None) -> np.ndarray:
    """Contact sheet of pictures (h, w, 3) uint8 of one height, `columns` in a row (None:
    `full_rows`); narrower tiles and the last row are filled up with grey, which neither a light
    page nor a dark one takes for a picture.
    """
    columns = columns or full_rows(len(tiles))
    width = max(t.shape[1] for t in tiles)
    beside = lambda tile: ((0, 0), (0, width - tile.shape[1]), (0, 0))
    tiles = [np.pad(tile, beside(tile), constant_values=FILLED) for tile in tiles]
    tiles += [np.full_like(tiles[0], FILLED)] * (-len(tiles) % columns)

    rows = [np.concatenate(tiles[k : k + columns], 1) for k in range(0, len(tiles), columns)]
    return np.concatenate(rows)


def read_exr(path: str | Path) -> np.ndarray:
    """(h, w, 3) or, for a file with one channel, (h, w), float32. Raises InputError when it cannot
    be read.
    """
    import OpenEXR

    try:
        with OpenEXR.File(str(path), separate_channels=False) as file:
            channels = file.channels()
            for name in ("RGBA", "RGB"):
                if name in channels:
                    return np.ascontiguousarray(channels[name].pixels[..., :3], np.float32)
            if all(c in channels for c in "RGB"):
                return np.stack([channels[c].pixels for c in "RGB"], -1).astype(np.float32)
            if len(channels) == 1:
                return np.array(next(iter(channels.values())).pixels, np.float32)
    except Exception as error:  # the binding raises bare RuntimeError/ValueError/OSError
        raise InputError(
            f"not a readable EXR file ({error})", path, "replace the file or leave it out"
        ) from error
    raise InputError(
        f"its channels are {', '.join(sorted(channels))}: neither R, G, B nor a single one",
        path,
        "export it with the channels R, G, B",
    )


def write_exr(path: str | Path, pixels: np.ndarray, half: bool = False) -> None:
    """Write (h, w, 3) as R, G, B or (h, w) as Y; ZIP compression, float32 unless `half`."""
    import OpenEXR

    pixels = np.asarray(pixels, np.float32)
    if not np.isfinite(pixels).all():
        raise ValueError(f"{path}: refusing to write NaN or infinity")

    if half:
        pixels = np.clip(pixels, -LARGEST_HALF, LARGEST_HALF).astype(np.float16)
    pixels = np.ascontiguousarray(pixels)

    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    with atomic_path(path) as temporary:
        with OpenEXR.File(header, {"RGB" if pixels.ndim == 3 else "Y": pixels}) as file:
            file.write(str(temporary))


def read_png(path: str | Path) -> np.ndarray:
    """8-bit image as uint8 (h, w, 3) or (h, w) for grey."""
    try:
        with Image.open(path) as image:
            if image.mode == "L":
                return np.asarray(image)
            return np.asarray(image.convert("L" if image.mode in "1I" else "RGB"))
    except OSError as error:
        raise InputError(f"not a readable image ({error})", path, "replace the file") from error


def write_png(path: str | Path, pixels: np.ndarray) -> None:
    """Write uint8 (h, w) or (h, w, 3); the format follows the suffix (.png or .jpg)."""
    with atomic_path(path) as temporary:
        options: dict[str, Any] = (
            {"quality": 90} if Path(path).suffix.lower() in (".jpg", ".jpeg") else {}
        )
        Image.fromarray(np.asarray(pixels, np.uint8)).save(temporary, **options)
