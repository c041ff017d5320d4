"""The object's surface as later stages have it: a mesh with its atlas, and the normal map that was
baked for that atlas.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from pipeline.geometry.mesh_io import Mesh, load_mesh
from pipeline.geometry.normal_maps import FILE, read_normal_map, write_normal_map


@dataclass(frozen=True)
class Surface:
    """mesh: file of the mesh; normal_map: file of its normal map, None where it has none. That the
    map lies beside its mesh is said here and nowhere else.
    """

    mesh: Path
    normal_map: Path | None

    @classmethod
    def of(cls, mesh: Path) -> Surface:
        """The surface of a mesh file."""
        file = Path(mesh).with_name(FILE)
        return cls(Path(mesh), file if file.exists() else None)

    def with_normals(self, normals: np.ndarray) -> Surface:
        """The surface with a map of these unit normals (t, t, 3) in their tangent frames, row 0 =
        v 1, which is written beside its mesh.
        """
        file = self.mesh.with_name(FILE)
        write_normal_map(file, normals)
        return Surface(self.mesh, file)

    @cached_property
    def geometry(self) -> Mesh:
        """The mesh. Raises InputError where it cannot be read."""
        return load_mesh(self.mesh)

    @cached_property
    def normals(self) -> np.ndarray | None:
        """The map's values (t, t, 3) in [0, 1], n / 2 + 1/2, None without a map. Raises InputError
        where it cannot be read.
        """
        return None if self.normal_map is None else read_normal_map(self.normal_map)
