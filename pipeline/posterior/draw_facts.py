"""What the sample stage knows about its draw and refinement asks for: `draw.json` beside
light.exr.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path

from pipeline.base.files import json_entry, write_json

FILE = "draw.json"


@dataclass(frozen=True)
class DrawFacts:
    """Facts about a draw that are not in its light and maps.

    scale_drawn: whether the sampler drew the light's scale, with roughness and metallic of
    regions; refinement then keeps them. Else it finds the scale itself.
    """

    scale_drawn: bool

    def save(self, folder: Path) -> None:
        """Write draw.json into the folder of the sample stage."""
        write_json(folder / FILE, asdict(self))

    @classmethod
    def load(cls, folder: Path) -> DrawFacts:
        """Read draw.json from the folder of the sample stage. Raises InputError where it is missing
        or incomplete.
        """
        return cls(scale_drawn=bool(json_entry(folder / FILE, "scale_drawn")))
