"""What the mesh stage knows about its surface and later stages ask for: `surface.json` beside
mesh.ply.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path

from pipeline.base.files import json_entry, write_json

FILE = "surface.json"


@dataclass(frozen=True)
class SurfaceFacts:
    """Facts about the object's surface that are not in its vertices and faces.

    normal_error: median angle in radians between the surface's vertex normals and the object's. The
    mesh stage estimates it by how much neighbouring normals wobble
    (`pipeline.geometry.mesh_io.normal_wobble`) and by what does not show so
    (`pipeline.surface.make.WIDE_ERROR`); 0 for a mesh that the user gave, whose wobble is meant.
    The sampler blurs reflections by it (`pipeline.posterior.split_gibbs`).
    """

    normal_error: float

    def save(self, folder: Path) -> None:
        """Write surface.json into the folder of the mesh stage."""
        write_json(folder / FILE, asdict(self))

    @classmethod
    def load(cls, folder: Path) -> SurfaceFacts:
        """Read surface.json from the folder of the mesh stage. Raises InputError where it is
        missing or incomplete.
        """
        return cls(normal_error=float(json_entry(folder / FILE, "normal_error")))
