"""Training data of the prior: real maps from a folder, filtered by licence, and procedural ones."""

from __future__ import annotations

import csv
import zlib
from pathlib import Path

import numpy as np

from ..envmap import check_lat_long, resample_area
from ..errors import InputError
from ..images import read_exr
from .code import scale_of, to_log
from .network import LABELS


def catalogue_rows(path: Path, licence_prefix: str) -> list[dict]:
    """Rows of the catalogue whose licence starts with the prefix and which are not flagged as low dynamic range."""
    with open(path, newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    kept = [r for r in rows if r["licence"].startswith(licence_prefix) and r["ldr"] != "1"]
    if not kept:
        raise InputError(f"no row has a licence starting with '{licence_prefix}'", path, "check licence_prefix in the configuration")
    return kept


def read_maps(folder: Path, rows: list[dict], height: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Maps (n, h, 2h, 3) resampled with their energy kept, labels (n,), and which are held out (n,) by name hash."""
    maps, labels, held = [], [], []
    for row in rows:
        path = folder / f"{row['name']}.exr"
        maps.append(resample_area(check_lat_long(read_exr(path), path), height, 2 * height))
        labels.append(LABELS.index(row["class"]))
        held.append(zlib.crc32(row["name"].encode()) % 10 == 0)
    return np.stack(maps), np.array(labels), np.array(held)


def to_codes(maps: np.ndarray) -> np.ndarray:
    """Divide every map by its scale and take logarithms: (n, 3, h, w)."""
    return np.stack([to_log(m / scale_of(m)) for m in maps])


class Batches:
    """Endless random batches: real maps with probability `real_share`, random yaw, random mirror."""

    def __init__(self, real, real_labels, made, made_labels, real_share: float, seed: int):
        self.sets = [(real, real_labels), (made, made_labels)]
        self.share, self.rng = (real_share if len(made) else 1.0), np.random.default_rng(seed)

    def draw(self, n: int) -> tuple[np.ndarray, np.ndarray]:
        """Codes (n, 3, h, w) and labels (n,)."""
        codes, labels = [], []
        for _ in range(n):
            source, names = self.sets[int(self.rng.random() >= self.share)]
            k = self.rng.integers(len(source))
            x = np.roll(source[k], self.rng.integers(source.shape[-1]), -1)
            codes.append(x[..., ::-1] if self.rng.random() < 0.5 else x)
            labels.append(names[k])
        return np.stack(codes), np.array(labels)
