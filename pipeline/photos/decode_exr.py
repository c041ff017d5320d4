"""A linear photo in an OpenEXR file, whatever its channels are called besides R, G and B."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pipeline.base.errors import InputError

COLOURS = ("R", "G", "B")
AGAIN = "export it with the channels R, G, B, or leave it out"


def decode_exr(path: Path) -> tuple[np.ndarray, list[str]]:
    """Pixels (h, w, 3 or 4) float32 of the display window, the fourth channel alpha in [0, 1], and
    notes on what was changed.

    A file of one channel Y is grey. Outside of the stored (data) window the picture is black and,
    where it has an alpha channel, transparent. Negative values, which no light has, become 0.
    Raises InputError for a damaged file, other channels, NaN or infinity.
    """
    channels, offset, size = _stored(path)
    if all(name in channels for name in COLOURS):
        planes = [channels[name] for name in COLOURS]
    elif "Y" in channels:
        planes = [channels["Y"]] * 3
    else:
        raise InputError(
            f"its channels are {', '.join(sorted(channels))}, not R, G, B", path, AGAIN
        )
    if "A" in channels:
        planes.append(channels["A"])

    pixels = np.stack(planes, -1).astype(np.float32)
    if not np.isfinite(pixels).all():
        raise InputError(
            "the picture holds NaN or infinity", path, "export it without them, or leave it out"
        )
    notes = []
    if pixels.min() < 0:
        notes.append(f"{100 * float((pixels < 0).any(-1).mean()):.2g} % negative pixels set to 0")
        pixels = np.maximum(pixels, 0)
    return _in_display_window(pixels, offset, size), notes


def _stored(path: Path) -> tuple[dict[str, np.ndarray], tuple[int, int], tuple[int, int]]:
    """Channels by name, (h, w) each; column and row of the stored window in the display window; and
    the display window's width and height.
    """
    import OpenEXR

    try:
        with OpenEXR.File(str(path), separate_channels=True) as file:
            channels = {name: np.array(c.pixels) for name, c in file.channels().items()}
            header = file.header()
            stored, shown = header["dataWindow"], header["displayWindow"]
    except Exception as error:  # the binding raises bare RuntimeError/ValueError/OSError
        raise InputError(
            f"not a readable EXR file ({error})", path, "replace the file or leave it out"
        ) from error

    low, high = np.array(shown[0]), np.array(shown[1])
    column, row = np.array(stored[0]) - low
    width, height = high - low + 1
    return channels, (int(column), int(row)), (int(width), int(height))


def _in_display_window(
    pixels: np.ndarray, offset: tuple[int, int], size: tuple[int, int]
) -> np.ndarray:
    """A stored window at its place in a picture of `size`; what lies outside of that is cut."""
    height, width = pixels.shape[:2]
    if offset == (0, 0) and size == (width, height):
        return pixels

    out = np.zeros((size[1], size[0], pixels.shape[2]), np.float32)
    left, top = max(offset[0], 0), max(offset[1], 0)
    right, bottom = min(offset[0] + width, size[0]), min(offset[1] + height, size[1])
    part = pixels[top - offset[1] : bottom - offset[1], left - offset[0] : right - offset[0]]
    out[top:bottom, left:right] = part
    return out
