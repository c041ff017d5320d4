"""The unit of a scene's radiance.

Everything after `capture` takes 1 for white: SIFT and masks look at 8 bits, errors have a floor,
scores end at white. A photo of integers brings that unit along: its full scale. An EXR may be in
any, cd/m2 or a renderer's own. `capture` finds one white for the scene, divides all photos by it
and writes it down; `export` multiplies the light by it, so that the asset is in the photos' unit.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from pipeline.base.files import json_entry, write_json
from pipeline.base.images import luminance

FILE = "radiance.json"
PERCENTILE = 95  # of a photo's luminance: above it lie highlights and lamps
USUAL = 0.1, 2.0  # levels at which 1 is as good a white as any
MIDDLE = 0.5  # level of a scene in the unit that is found for it


@dataclass(frozen=True)
class Radiance:
    """white: the radiance, in the unit of the user's photos, that is 1 in all pictures and lights
    of the scene's work folder.
    """

    white: float

    def save(self, folder: Path) -> None:
        """Write radiance.json into the folder of the capture stage."""
        write_json(folder / FILE, asdict(self))

    @classmethod
    def load(cls, folder: Path) -> Radiance:
        """Read radiance.json from the folder of the capture stage. Raises InputError where it is
        missing.
        """
        return cls(white=float(json_entry(folder / FILE, "white")))


def level_of(linear: np.ndarray, mask: np.ndarray | None = None) -> float:
    """Luminance of a photo (h, w, 3) that few of its pixels exceed, of those in `mask` (h, w) that
    are not black; 0 for a black one.
    """
    values = luminance(linear if mask is None else linear[mask]).ravel()
    values = values[values > 0]
    return float(np.percentile(values, PERCENTILE)) if len(values) else 0.0


def white_of(levels: list[float]) -> float:
    """The white of photos with these levels (`level_of`): 1 where their median is usual, else a
    power of two, which changes no digit of a float.
    """
    level = float(np.median(levels))
    if level == 0 or USUAL[0] <= level <= USUAL[1]:
        return 1.0
    return float(2.0 ** np.round(np.log2(level / MIDDLE)))
