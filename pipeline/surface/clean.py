"""From a field to a closed, decimated triangle mesh."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from pipeline.base.errors import InputError
from pipeline.geometry.mesh_io import Mesh, vertex_normals
from pipeline.geometry.voxels import Grid
from pipeline.surface.solids import Covered, contour, whole_solids


def to_mesh(field: np.ndarray, grid: Grid, covered: Covered | None = None) -> Mesh:
    """`zero_surface`. Raises InputError where there is none."""
    mesh = zero_surface(field, grid, covered)
    if mesh is None:
        raise InputError(
            "the masks leave no volume", "mesh", "check the masks (work/<scene>/masks/overlay.jpg)"
        )
    return mesh


def zero_surface(
    field: np.ndarray, grid: Grid, covered: Covered | None = None, blur: float = 0.7
) -> Mesh | None:
    """The closed zero surface of the object's solids (`whole_solids`); None where nothing is
    inside. blur: of the field, in cells; it evens the surface, and takes from what is thin.
    """
    whole = whole_solids(ndimage.gaussian_filter(field, blur), grid, covered)
    return contour(whole, grid) if whole.max() > 0 else None


class Decimation:
    """A surface on its way to fewer triangles: repaired, lightly smoothed (Taubin), then decimated
    (quadrics) as often as it is asked to, by pymeshlab.
    """

    def __init__(self, mesh: Mesh):
        import pymeshlab

        self.meshes = pymeshlab.MeshSet()
        self.meshes.add_mesh(pymeshlab.Mesh(mesh.vertices, mesh.faces))
        self.meshes.meshing_remove_duplicate_vertices()
        self.meshes.meshing_remove_null_faces()
        self.meshes.apply_coord_taubin_smoothing(stepsmoothnum=6)

    def to(self, faces: int) -> Mesh:
        """The surface with about so many triangles, from what the last call left of it."""
        self.meshes.meshing_decimation_quadric_edge_collapse(
            targetfacenum=faces,
            preservenormal=True,
            preservetopology=True,
            optimalplacement=True,
            qualitythr=0.4,
        )
        self.meshes.meshing_repair_non_manifold_edges()
        self.meshes.meshing_repair_non_manifold_vertices()
        self.meshes.meshing_close_holes(maxholesize=200)
        self.meshes.meshing_remove_unreferenced_vertices()
        return self.mesh()

    def mesh(self) -> Mesh:
        """The surface as it is now, its triangles counter-clockwise from outside."""
        current = self.meshes.current_mesh()
        vertices = current.vertex_matrix()
        triangles = current.face_matrix().astype(np.int64)
        if signed_volume(vertices, triangles) < 0:
            triangles = triangles[:, ::-1]
        return Mesh(vertices, triangles, vertex_normals(vertices, triangles))


def signed_volume(vertices: np.ndarray, faces: np.ndarray) -> float:
    """Volume of a closed mesh, positive where its faces are counter-clockwise from outside."""
    return float(volumes(vertices, faces).sum())


def volumes(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """What every face (m, 3) adds to the signed volume, (m,): its tetrahedron with the origin."""
    first, second, third = (vertices[faces[:, corner]] for corner in range(3))
    return (first * np.cross(second, third)).sum(1) / 6


def facts(mesh: Mesh) -> dict:
    """Whether it is watertight and manifold, number of parts, vertices and faces, size: by
    Open3D.
    """
    from pipeline.base.runtime import import_open3d

    o3d = import_open3d()
    shell = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(mesh.vertices), o3d.utility.Vector3iVector(mesh.faces)
    )
    parts = np.asarray(shell.cluster_connected_triangles()[1])
    closed = shell.is_edge_manifold(allow_boundary_edges=False) and shell.is_vertex_manifold()
    return {
        "watertight": bool(closed),
        "parts": len(parts),
        "vertices": len(mesh.vertices),
        "faces": len(mesh.faces),
        "size": np.ptp(mesh.vertices, axis=0).tolist(),
    }
