"""What the masks stage knows about its masks and the mesh stage asks for: `given.json` beside
masks/.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path

from pipeline.base.files import json_entry, write_json

FILE = "given.json"


@dataclass(frozen=True)
class MaskFacts:
    """all_given: whether every mask is the user's own; given: names of the views whose mask is;
    carving: of those whose mask agrees with the others, and so may take volume away; center (3,)
    and radius: the sphere that the object lies in, which the masks may have shown to be wider than
    matched points did (sphere.py).
    """

    all_given: bool
    given: tuple[str, ...]
    carving: tuple[str, ...]
    center: tuple[float, ...]
    radius: float

    def save(self, folder: Path) -> None:
        """Write given.json into the folder of the masks stage."""
        write_json(folder / FILE, asdict(self))

    @classmethod
    def load(cls, folder: Path) -> MaskFacts:
        """Read given.json from the folder of the masks stage. Raises InputError where it is missing
        or incomplete.
        """
        file = folder / FILE
        return cls(
            bool(json_entry(file, "all_given")),
            tuple(json_entry(file, "given")),
            tuple(json_entry(file, "carving")),
            tuple(json_entry(file, "center")),
            float(json_entry(file, "radius")),
        )
