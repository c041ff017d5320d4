"""What the numbers in a photo's file mean: its transfer curve and its primaries, from an ICC
profile, from HEIF's own code points or from EXIF; and from there to linear Rec.709.

A curve acts on each channel, the primaries are one matrix. Scaling a picture down lies between the
two: the mean of light is taken in linear light, and the matrix on few pixels costs nothing.

Sources: ICC.1:2022 (profile v2 and v4, tags `rTRC` .. `bTRC`, `kTRC`, `rXYZ` .. `bXYZ`), ITU-T
H.273 (code points), DCF 2.0 (Adobe RGB marked in EXIF).
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from pipeline.base.images import srgb_to_linear

# encoded values in [0, 1] -> linear values, of any shape
Curve: TypeAlias = Callable[[np.ndarray], np.ndarray]
# Columns: XYZ of red, green and blue of sRGB, adapted to D50 as in every ICC profile.
SRGB_D50 = np.array(
    [[0.43607, 0.38515, 0.14307], [0.22249, 0.71687, 0.06061], [0.01392, 0.09708, 0.71410]]
)
D65 = (0.3127, 0.3290)
# x, y of red, green and blue
REC709 = ((0.640, 0.330), (0.300, 0.600), (0.150, 0.060))
ADOBE_RGB = ((0.640, 0.330), (0.210, 0.710), (0.150, 0.060))
# H.273 colour primaries: name, chromaticities. 2 is unspecified, for which HEIF asks for Rec.709.
PRIMARIES = {
    1: ("Rec.709", REC709),
    2: ("Rec.709", REC709),
    9: ("Rec.2020", ((0.708, 0.292), (0.170, 0.797), (0.131, 0.046))),
    12: ("Display P3", ((0.680, 0.320), (0.265, 0.690), (0.150, 0.060))),
}
SAME = 2e-3  # difference of linear values up to which a profile is sRGB: half a step of 8 bits


@dataclass
class ColourSpace:
    """`curves` (3 of them) take encoded red, green and blue in [0, 1] to linear light; `matrix`
    (3, 3) takes that to linear Rec.709. `name` is for the user.
    """

    name: str
    curves: tuple[Curve, Curve, Curve]
    matrix: np.ndarray

    @property
    def is_rec709(self) -> bool:
        """Whether red, green and blue are Rec.709's own."""
        return np.array_equal(self.matrix, np.eye(3))

    def to_rec709(self, linear: np.ndarray) -> np.ndarray:
        """Linear light (..., 3) of these primaries -> linear Rec.709; colours outside of its gamut
        keep their red, green and blue above 1 and lose what is below 0.
        """
        if self.is_rec709:
            return linear
        return np.maximum(linear @ self.matrix.T.astype(np.float32), 0)

    def is_srgb(self) -> bool:
        """Whether it differs from sRGB by less than 8 bits can tell."""
        x = np.linspace(0, 1, 256)
        same = all(np.abs(curve(x) - srgb_to_linear(x)).max() < SAME for curve in self.curves)
        return same and bool(np.abs(self.matrix - np.eye(3)).max() < SAME)


def _linear(x: np.ndarray) -> np.ndarray:
    return np.asarray(x, np.float32)


SRGB = ColourSpace("sRGB", (srgb_to_linear,) * 3, np.eye(3))
LINEAR = ColourSpace("linear Rec.709", (_linear,) * 3, np.eye(3))


class UnknownProfile(ValueError):
    """A profile that is not three curves and a matrix."""


def xyz_of_primaries(primaries: tuple, white: tuple[float, float] = D65) -> np.ndarray:
    """Matrix (3, 3), linear RGB -> XYZ, of chromaticities x, y of red, green, blue and white whose
    luminance is 1.
    """
    columns = np.array([[x / y, 1.0, (1 - x - y) / y] for x, y in primaries]).T
    x, y = white
    return columns * np.linalg.solve(columns, [x / y, 1.0, (1 - x - y) / y])


def rec709_from(primaries: tuple) -> np.ndarray:
    """Matrix (3, 3) from linear RGB of primaries under D65 to linear Rec.709."""
    return np.linalg.solve(xyz_of_primaries(REC709), xyz_of_primaries(primaries))


def adobe_rgb() -> ColourSpace:
    """Adobe RGB (1998): gamma 563 / 256."""
    curve: Curve = lambda x: np.asarray(x, np.float32) ** (563 / 256)
    return ColourSpace("Adobe RGB", (curve,) * 3, rec709_from(ADOBE_RGB))


def of_code_points(primaries: int, transfer: int) -> ColourSpace:
    """Colour space of H.273 code points, as HEIF's `nclx` box holds them. UnknownProfile for HDR
    curves (PQ, HLG), which say nothing of the light on the sensor, and for rare primaries.
    """
    if primaries not in PRIMARIES:
        raise UnknownProfile(f"colour primaries {primaries} of H.273")
    curves: dict[int, Curve] = {2: srgb_to_linear, 13: srgb_to_linear, 8: _linear}
    curves |= dict.fromkeys((1, 6, 14, 15), _rec709_curve)
    if transfer not in curves:
        hdr = {16: "PQ (HDR)", 18: "HLG (HDR)"}.get(transfer, f"number {transfer} of H.273")
        raise UnknownProfile(f"the transfer curve {hdr}")

    name, chromaticities = PRIMARIES[primaries]
    matrix = np.eye(3) if chromaticities == REC709 else rec709_from(chromaticities)
    space = ColourSpace(name, (curves[transfer],) * 3, matrix)
    return SRGB if space.is_srgb() else space


def _rec709_curve(x: np.ndarray) -> np.ndarray:
    """Inverse of ITU-R BT.709's curve."""
    x = np.asarray(x, np.float32)
    return np.where(x < 0.081, x / 4.5, ((x + 0.099) / 1.099) ** (1 / 0.45)).astype(np.float32)


# equal parts of a display's primaries are about white; where they are off by more, a profile is
# damaged
FAR_FROM_WHITE = 4.0


def of_icc(profile: bytes) -> ColourSpace:
    """Colour space of an ICC profile that consists of curves and a matrix, or, for grey, of one
    curve. UnknownProfile for those with tables (printers, scanners) and for damaged ones;
    ValueError for one whose white is none.
    """
    try:
        tags = _tags(profile)
        kind = profile[16:20]
        if kind == b"GRAY":
            curve = _curve(tags[b"kTRC"])
            space = ColourSpace("grey by its profile", (curve,) * 3, np.eye(3))
        elif kind == b"RGB " and profile[20:24] == b"XYZ ":
            red, green, blue = (_curve(tags[name]) for name in (b"rTRC", b"gTRC", b"bTRC"))
            colorants = np.stack([_xyz(tags[name]) for name in (b"rXYZ", b"gXYZ", b"bXYZ")], 1)
            matrix = np.linalg.solve(SRGB_D50, colorants)
            white = matrix.sum(1)
            if not (1 / FAR_FROM_WHITE < white).all() or not (white < FAR_FROM_WHITE).all():
                raise ValueError(f"its profile is damaged: white is {white.round(2)} of sRGB's")
            space = ColourSpace(_description(tags), (red, green, blue), matrix)
        else:
            raise UnknownProfile(f"a profile of kind {kind.decode('latin-1').strip()}")
    except (KeyError, struct.error, IndexError, np.linalg.LinAlgError) as error:
        raise UnknownProfile(f"a profile without curves and matrix ({error!r})") from error
    return SRGB if space.is_srgb() else space


def _tags(profile: bytes) -> dict[bytes, bytes]:
    """The tagged elements of an ICC profile."""
    (count,) = struct.unpack_from(">I", profile, 128)
    if count > 1000:
        raise UnknownProfile("a damaged profile")

    out = {}
    for k in range(count):
        name, offset, size = struct.unpack_from(">4sII", profile, 132 + 12 * k)
        out[name] = profile[offset : offset + size]
    return out


def _fixed(data: bytes, offset: int, count: int) -> np.ndarray:
    """`count` numbers of the type s15Fixed16."""
    return np.array(struct.unpack_from(f">{count}i", data, offset)) / 65536


def _xyz(tag: bytes) -> np.ndarray:
    return _fixed(tag, 8, 3)


def _curve(tag: bytes) -> Curve:
    """The transfer curve of a `curv` or `para` element."""
    if tag[:4] == b"curv":
        (count,) = struct.unpack_from(">I", tag, 8)
        if count == 0:
            return _linear
        values = np.array(struct.unpack_from(f">{count}H", tag, 12))
        if count == 1:
            return lambda x: np.asarray(x, np.float32) ** np.float32(values[0] / 256)
        places = np.linspace(0, 1, count)
        return lambda x: np.interp(x, places, values / 65535).astype(np.float32)

    if tag[:4] != b"para":
        raise UnknownProfile(f"a curve of type {tag[:4].decode('latin-1')}")
    (kind,) = struct.unpack_from(">H", tag, 8)
    return _parametric(kind, _fixed(tag, 12, (1, 3, 4, 5, 7)[kind]))


def _parametric(kind: int, parameters: np.ndarray) -> Curve:
    """Types 0 to 4 of ICC.1's parametricCurveType: (a x + b)^g + e from d on, c x + f below."""
    g, a, b, c, d, e, f = 1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0
    if kind == 0:
        (g,) = parameters
    elif kind in (1, 2):
        g, a, b = parameters[:3]
        e = f = parameters[3] if kind == 2 else 0.0
        d = -b / a
    else:
        g, a, b, c, d = parameters[:5]
        e, f = parameters[5:] if kind == 4 else (0.0, 0.0)

    def curve(x: np.ndarray) -> np.ndarray:
        x = np.asarray(x, np.float64)
        above = np.maximum(a * x + b, 0) ** g + e
        return np.where(x >= d, above, c * x + f).clip(0, 1).astype(np.float32)

    return curve


def _description(tags: dict[bytes, bytes]) -> str:
    """The profile's name for people: `desc` (v2) or the first text of `mluc` (v4)."""
    tag = tags.get(b"desc", b"")
    if tag[:4] == b"mluc":
        size, offset = struct.unpack_from(">II", tag, 20)
        text = tag[offset : offset + size].decode("utf-16-be", "replace")
    else:
        text = tag[12:].split(b"\0")[0].decode("latin-1")
    return text.strip("\0 ") or "an unnamed profile"
