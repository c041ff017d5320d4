"""A mesh file's triangles by Open3D, as a program of its own: a damaged file may crash the reader,
and should take nothing else with it.

python -m pipeline.surface.read_mesh_file MESH OUT.npz
"""

from __future__ import annotations

import sys

import numpy as np

from pipeline.base.runtime import import_open3d


def main() -> None:
    """Write vertices (n, 3), triangles (m, 3) and vertex normals (n or 0, 3) of MESH to OUT."""
    o3d = import_open3d()
    with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
        found = o3d.io.read_triangle_mesh(sys.argv[1])
    np.savez(
        sys.argv[2],
        vertices=np.asarray(found.vertices),
        faces=np.asarray(found.triangles).astype(np.int64),
        normals=np.asarray(found.vertex_normals),
    )


if __name__ == "__main__":
    main()
