"""Small photo files as cameras and programs write them: a picture of four flat quarters, colour
profiles, 16 bits, EXIF.

The files in data/ were written with pillow-heif 1.8.1 (x265, 4:4:4, quality 95), which can write
HEIC and is no dependency. All but ten_bit.heic (a ramp from left to right) show PICTURE.
"""

import struct
from pathlib import Path

import numpy as np
from PIL import Image

DATA = Path(__file__).parent / "data"
QUARTERS = np.array([[[200, 40, 40], [40, 180, 60]], [[50, 60, 190], [120, 120, 120]]], np.uint8)
PICTURE = np.kron(QUARTERS, np.ones((24, 32, 1), np.uint8))
# How a camera held so stores an upright picture: EXIF's orientation -> stored from upright.
STORED = {
    0: lambda a: a,
    1: lambda a: a,
    2: np.fliplr,
    3: lambda a: np.rot90(a, 2),
    4: np.flipud,
    5: lambda a: a.swapaxes(0, 1),
    6: lambda a: np.rot90(a, 1),
    7: lambda a: np.rot90(a, 2).swapaxes(0, 1),
    8: lambda a: np.rot90(a, 3),
}
# Colorants (XYZ under D50) as the profiles of Adobe and Apple hold them
ADOBE = ((0.60974, 0.31111, 0.01947), (0.20528, 0.62567, 0.06087), (0.14919, 0.06322, 0.74457))
P3 = ((0.51512, 0.24120, -0.00105), (0.29198, 0.69225, 0.04189), (0.15710, 0.06657, 0.78407))


def exif_of(orientation: int) -> Image.Exif:
    exif = Image.Exif()
    exif[0x0112] = orientation
    return exif


def fixed(*numbers: float) -> bytes:
    return struct.pack(f">{len(numbers)}i", *(round(65536 * x) for x in numbers))


def gamma_curve(gamma: float) -> bytes:
    """A `curv` element of one number."""
    return b"curv\0\0\0\0" + struct.pack(">IH", 1, round(256 * gamma)) + b"\0\0"


def sampled_curve(values: np.ndarray) -> bytes:
    """A `curv` element with a table of values in [0, 1]."""
    table = np.round(65535 * np.asarray(values)).astype(">u2").tobytes()
    return b"curv\0\0\0\0" + struct.pack(">I", len(values)) + table


def srgb_curve() -> bytes:
    """A `para` element of type 3, as in Apple's Display P3."""
    return b"para\0\0\0\0\0\3\0\0" + fixed(2.4, 1 / 1.055, 0.055 / 1.055, 1 / 12.92, 0.04045)


def icc_profile(colorants, curve: bytes, name: str = "test") -> bytes:
    """A display profile, version 2, of three colorants and one curve."""
    text = name.encode() + b"\0"
    elements = {
        b"desc": b"desc\0\0\0\0" + struct.pack(">I", len(text)) + text + bytes(78),
        b"cprt": b"text\0\0\0\0CC0\0",
        b"wtpt": b"XYZ \0\0\0\0" + fixed(0.96420, 1.0, 0.82491),
        **{
            tag: b"XYZ \0\0\0\0" + fixed(*xyz)
            for tag, xyz in zip((b"rXYZ", b"gXYZ", b"bXYZ"), colorants)
        },
        **dict.fromkeys((b"rTRC", b"gTRC", b"bTRC"), curve),
    }
    body, table, offset = b"", b"", 128 + 4 + 12 * len(elements)
    for tag, element in elements.items():
        padded = element + bytes(-len(element) % 4)
        table += struct.pack(">4sII", tag, offset + len(body), len(element))
        body += padded
    head = bytearray(128)
    struct.pack_into(">I", head, 0, offset + len(body))
    head[8:12] = b"\2\x40\0\0" if curve[:4] == b"curv" else b"\4\0\0\0"
    head[12:24] = b"mntrRGB XYZ "
    head[36:40] = b"acsp"
    head[68:80] = fixed(0.96420, 1.0, 0.82491)
    return bytes(head) + struct.pack(">I", len(elements)) + table + body


ADOBE_PROFILE = icc_profile(ADOBE, gamma_curve(563 / 256), "Adobe RGB (1998)")
P3_PROFILE = icc_profile(P3, srgb_curve(), "Display P3")
