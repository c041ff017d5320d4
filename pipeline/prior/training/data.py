"""Training data of the prior: measured maps, maps expanded from LDR, and procedural ones; one cache
serves models of every size.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pipeline.base.errors import InputError
from pipeline.base.files import atomic_path
from pipeline.base.progress import progress
from pipeline.prior.training.augment import draw_view
from pipeline.prior.training.procedural import generate
from pipeline.prior.training.sources import find_sources, read_source
from pipeline.prior.training.strong_views import draw_strong_view
from pipeline.prior.value_code import scale_of, to_log
from pipeline.prior.weight_facts import LABELS
from pipeline.render.envmap import resample_area

ROWS = 128  # of cached maps; models have 64 or fewer: views turn by fractions of their pixels
HELD_OUT = 10  # one of so many measured maps, by hash of its name, is never trained on


def is_held_out(name: str) -> bool:
    return zlib.crc32(name.encode()) % HELD_OUT == 0


def scale_free(env: np.ndarray) -> np.ndarray:
    """A map divided by its scale (`value_code.scale_of`): exposure says nothing of the place."""
    return env / max(scale_of(env), 1e-12)


def half(env: np.ndarray) -> np.ndarray:
    """Radiance as float16 square roots: a sun stays in range, and the relative error below 0.1
    %.
    """
    not_negative = np.maximum(env, 0)  # rounding of the resampling leaves -1e-9 here and there
    return np.sqrt(not_negative).astype(np.float16)


def radiance(stored: np.ndarray) -> np.ndarray:
    """Inverse of `half`."""
    return stored.astype(np.float32) ** 2


def make_cache(
    folder: Path,
    catalogue: Path | None,
    licence_prefix: str,
    procedural: int,
    seed: int,
    cache: Path,
) -> None:
    """Read and make all maps and write them to `cache` (.npz): see `Data`. Raises InputError for
    unusable files.
    """
    sources = find_sources(folder, catalogue, licence_prefix)
    maps = [
        half(scale_free(resample_area(read_source(s.path), ROWS, 2 * ROWS)))
        for s in progress(sources, "reading maps")
    ]
    made, made_labels = generate(procedural, ROWS, seed)

    expanded = np.array([s.expanded for s in sources])
    held = np.array([is_held_out(s.path.stem) for s in sources]) & ~expanded
    with atomic_path(cache) as temporary, open(temporary, "wb") as file:
        np.savez(
            file,
            maps=np.stack(maps + [half(scale_free(m)) for m in made]),
            labels=np.concatenate([[s.label for s in sources], made_labels]).astype(int),
            made=np.concatenate([expanded, np.ones(len(made), bool)]),
            held=np.concatenate([held, np.zeros(len(made), bool)]),
        )


@dataclass
class Data:
    """maps (n, ROWS, 2 ROWS, 3): `half` of scale-free radiance; labels (n,): index in LABELS,
    len(LABELS) for unknown; made (n,): procedural or expanded from LDR; held (n,): never trained
    on. mean, std: of the value code, from measured maps trained on.
    """

    maps: np.ndarray
    labels: np.ndarray
    made: np.ndarray
    held: np.ndarray
    height: int
    mean: float = 0.0
    std: float = 1.0

    @classmethod
    def load(cls, cache: Path, height: int) -> Data:
        """Raises InputError when `cache` was not written by `make_cache` or has no measured map to
        train on.
        """
        try:
            with np.load(cache) as file:
                maps, labels, made, held = (file[k] for k in ("maps", "labels", "made", "held"))
                data = cls(maps, labels, made, held, height)
        except (OSError, KeyError, ValueError) as error:
            what = f"not a cache of training maps ({type(error).__name__}: {error})"
            raise InputError(what, cache, "remove it; it is made anew") from error
        if not (~data.made & ~data.held).any():
            raise InputError(
                "no measured map is left to train on", cache, "give more .exr or .hdr maps"
            )

        known = data.logs(~data.made & ~data.held)
        data.mean = float(known.mean())
        data.std = float(known.std())
        return data

    def logs(self, chosen: np.ndarray) -> np.ndarray:
        """Log radiance (k, 3, height, 2 height) of the chosen maps as they are."""
        small = [
            to_log(scale_free(resample_area(radiance(m), self.height, 2 * self.height)))
            for m in self.maps[chosen]
        ]
        return np.array(small, np.float32).reshape(-1, 3, self.height, 2 * self.height)

    def codes(self, logs: np.ndarray) -> np.ndarray:
        """The value code's affine part, float32."""
        return ((logs - self.mean) / (2 * self.std)).astype(np.float32)

    def measured(self, held: bool) -> np.ndarray:
        """Codes (k, 3, height, 2 height) of the measured maps that are, or are not, held out."""
        return self.codes(self.logs(~self.made & (self.held == held)))


class Batches:
    """Endless random batches of augmented views: of measured maps with probability `real_share`,
    and of these with probability `strong_share` strong ones, which count as made.
    """

    def __init__(self, data: Data, real_share: float, seed: int, strong_share: float = 0.0):
        self.data = data
        self.rng = np.random.default_rng(seed)
        self.sets = [np.flatnonzero(~data.made & ~data.held), np.flatnonzero(data.made)]
        self.share = real_share if len(self.sets[1]) else 1.0
        self.strong_share = strong_share

    def draw(self, n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Codes (n, 3, h, w), labels (n,) and whether made (n,)."""
        drawn = [self._view() for _ in range(n)]
        views, labels, made = (list(column) for column in zip(*drawn))
        return self.data.codes(np.stack(views)), np.array(labels), np.array(made)

    def _view(self) -> tuple[np.ndarray, int, bool]:
        """Log radiance (3, h, w), label and whether made, of one view."""
        data, rng = self.data, self.rng
        measured = rng.random() < self.share
        k = rng.choice(self.sets[int(not measured)])
        label, made = int(data.labels[k]), bool(data.made[k])
        if measured and rng.random() < self.strong_share:
            other = rng.choice(self.sets[0])
            env, both = draw_strong_view(self._map(k), self._map(other), data.height, rng)
            label = len(LABELS) if both and data.labels[other] != label else label
            made = True
        else:
            env = draw_view(radiance(data.maps[k]), data.height, rng)
        return to_log(scale_free(env)), label, made

    def _map(self, k: int) -> np.ndarray:
        return scale_free(radiance(self.data.maps[k]))
