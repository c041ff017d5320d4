"""Lat-long maps on disk: .exr and .hdr as measured radiance; .jpg and .png as a lower tier,
expanded and marked.
"""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pipeline.base.errors import InputError, nearest
from pipeline.base.images import luminance, read_exr, read_png, srgb_to_linear
from pipeline.prior.weight_facts import LABELS
from pipeline.render.envmap import check_lat_long

MEASURED = (".exr", ".hdr")
EXPANDABLE = (".jpg", ".jpeg", ".png")
COLUMNS = ("name", "class", "licence", "ldr")
PEAK = 50.0  # radiance that inverse tone mapping gives to white, over that of middle grey x 5.6


@dataclass(frozen=True)
class Source:
    """One map: file, index of its class in LABELS (len(LABELS): unknown), and whether its range is
    only expanded from LDR.
    """

    path: Path
    label: int
    expanded: bool


def find_sources(folder: Path, catalogue: Path | None, licence_prefix: str = "") -> list[Source]:
    """The maps of a folder, or those rows of a catalogue (CSV: name, class, licence, ldr) whose
    licence begins with the prefix.

    Without a catalogue every map is taken, without class. Raises InputError when nothing is left, a
    listed file is missing or a class is unknown.
    """
    present = sorted(Path(folder).iterdir()) if Path(folder).is_dir() else []
    files = {p.stem: p for p in present if p.suffix.lower() in MEASURED + EXPANDABLE}
    if not files:
        raise InputError(
            "holds no .exr, .hdr, .jpg or .png map",
            folder,
            "point --data at a folder of lat-long environment maps",
        )
    if catalogue is None:
        return [Source(p, len(LABELS), p.suffix.lower() in EXPANDABLE) for p in files.values()]

    out = []
    for row in _rows(Path(catalogue)):
        if not row["licence"].startswith(licence_prefix):
            continue
        if row["name"] not in files:
            raise InputError(
                f"lists '{row['name']}', which is not in {folder}",
                catalogue,
                "remove the row or add the file",
            )
        if row["class"] not in LABELS:
            raise InputError(
                f"class '{row['class']}' of '{row['name']}' is unknown",
                catalogue,
                nearest(row["class"], LABELS),
            )

        path = files[row["name"]]
        expanded = row["ldr"] == "1" or path.suffix.lower() in EXPANDABLE
        out.append(Source(path, LABELS.index(row["class"]), expanded))

    if not out:
        raise InputError(
            f"no row has a licence starting with '{licence_prefix}'",
            catalogue,
            "check licence_prefix in the configuration",
        )
    return out


def _rows(path: Path) -> list[dict]:
    """Rows of a catalogue, each with all of COLUMNS."""
    cure = f"give a CSV with the columns {', '.join(COLUMNS)}"
    try:
        with open(path, newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"not a readable catalogue ({error})", path, cure) from error

    missing = set(COLUMNS) - set(rows[0] if rows else ())
    if missing:
        raise InputError(f"lacks the columns {', '.join(sorted(missing))}", path, cure)
    return rows


def read_source(path: Path) -> np.ndarray:
    """Radiance (h, w, 3), float32, of any supported file. Raises InputError: unreadable, not 2:1,
    NaN or negative.
    """
    suffix = path.suffix.lower()
    if suffix == ".exr":
        env = read_exr(path)
    elif suffix == ".hdr":
        env = _read_hdr(path)
    else:
        pixels = read_png(path)
        if pixels.ndim == 2:
            pixels = np.repeat(pixels[..., None], 3, -1)
        env = expand(srgb_to_linear(pixels / 255.0))
    return check_lat_long(env, path)


def _read_hdr(path: Path) -> np.ndarray:
    """Radiance (h, w, 3) of a Radiance HDR file."""
    import cv2

    try:
        pixels = cv2.imread(str(path), cv2.IMREAD_ANYDEPTH | cv2.IMREAD_COLOR)
    except cv2.error as error:
        raise InputError(
            f"not a readable Radiance HDR file ({error})", path, "replace the file or leave it out"
        ) from error
    if pixels is None or pixels.dtype != np.float32:
        raise InputError(
            "not a readable Radiance HDR file", path, "replace the file or leave it out"
        )
    return np.ascontiguousarray(pixels[..., ::-1])


def expand(linear: np.ndarray) -> np.ndarray:
    """Inverse tone mapping of display-linear values in [0, 1]: the inverse of Reinhard's curve with
    white at PEAK.

    Reinhard et al. 2002, Eq. 4, solved for world luminance; colour ratios are kept. What was
    clipped stays unknown: such maps are marked and train the shape of scenes, not the height of
    their peaks.
    """
    # y (1 + L) = L (1 + L / P^2)  =>  L^2 / P^2 - b L - y = 0, b = y - 1, P = PEAK
    y = np.clip(luminance(linear), 0, 1)
    b = y - 1
    world = 0.5 * PEAK**2 * (b + np.sqrt(b * b + 4 * y / PEAK**2))
    return (linear * (world / np.maximum(y, 1e-6))[..., None]).astype(np.float32)
