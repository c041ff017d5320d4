"""Triangle meshes in memory and on disk (PLY, OBJ). v of uv points up, as in OBJ and USD."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy import sparse

from pipeline.base.errors import InputError
from pipeline.base.files import atomic_path


@dataclass
class Mesh:
    """vertices (n, 3); faces (m, 3) counter-clockwise from outside; normals (n, 3); uv (n, 2) or
    None.
    """

    vertices: np.ndarray
    faces: np.ndarray
    normals: np.ndarray
    uv: np.ndarray | None = None


def unit(v: np.ndarray) -> np.ndarray:
    """Rows of v (n, 3) at length 1; zero stays zero."""
    return v / np.maximum(np.linalg.norm(v, axis=1, keepdims=True), 1e-20)


def vertex_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Area-weighted unit normals (n, 3)."""
    first, second, third = (vertices[faces[:, corner]] for corner in range(3))
    cross = np.cross(second - first, third - first)  # twice the face's area long

    out = np.zeros_like(vertices, dtype=float)
    for corner in range(3):
        np.add.at(out, faces[:, corner], cross)
    return unit(out)


def vertex_adjacency(count: int, faces: np.ndarray) -> sparse.csr_matrix:
    """Which of `count` vertices an edge of `faces` (m, 3) joins: (count, count) bool, symmetric."""
    one_end = faces.ravel()
    other_end = np.roll(faces, 1, axis=1).ravel()
    linked = np.ones(len(one_end), bool)
    edges = sparse.coo_matrix((linked, (one_end, other_end)), (count, count)).tocsr()
    return edges + edges.T


def normal_wobble(mesh: Mesh) -> float:
    """Median angle (radians) between a vertex's normal and its neighbours' mean. Of even curvature
    it is 0, of noise the noise's own size.
    """
    mean = unit(vertex_adjacency(len(mesh.vertices), mesh.faces) @ mesh.normals)
    cosine = (mean * mesh.normals).sum(1)
    return float(np.median(np.arccos(np.clip(cosine, -1, 1))))


def sample_surface(
    mesh: Mesh, count: int, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Points (count, 3) evenly over the surface and their faces' unit normals (count, 3)."""
    corners = mesh.vertices[mesh.faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(cross, axis=1)

    face = rng.choice(len(area), count, p=area / area.sum())
    low, high = np.sort(rng.random((count, 2)), axis=1).T
    barycentric = np.stack([low, high - low, 1 - high], -1)
    where = np.einsum("nk,nkc->nc", barycentric, corners[face])
    return where, cross[face] / np.maximum(area[face], 1e-20)[:, None]


def load_mesh(path: str | Path) -> Mesh:
    """Read a PLY or OBJ by Mitsuba's loaders, with the texture coordinates that it has; normals
    that it lacks are computed. Raises InputError for a missing or unreadable file.
    """
    from pipeline.base.runtime import mitsuba as mi

    path = Path(path)
    if not path.exists():
        raise InputError(
            "the mesh does not exist", path, "run the stage that makes it, or correct the path"
        )
    try:
        loaded = mi.load_dict(
            {"type": path.suffix[1:].lower(), "filename": str(path), "flip_tex_coords": False}
        )
    except (RuntimeError, UnicodeDecodeError) as error:  # the latter of the reader's own message
        raise InputError(
            f"not a readable mesh ({error})", path, "export it as binary PLY or OBJ with triangles"
        ) from error

    table = lambda key, columns, kind: np.array(mi.traverse(loaded)[key], kind).reshape(-1, columns)
    vertices = table("vertex_positions", 3, np.float64)
    faces = table("faces", 3, np.int64)
    if loaded.has_vertex_normals():
        normals = table("vertex_normals", 3, np.float64)
    else:
        normals = vertex_normals(vertices, faces)
    uv = table("vertex_texcoords", 2, np.float64) if loaded.has_vertex_texcoords() else None
    return Mesh(vertices, faces, normals, uv)


def save_mesh(path: str | Path, mesh: Mesh) -> None:
    """Write binary PLY (x y z nx ny nz u v) or, by suffix, OBJ."""
    path = Path(path)
    with atomic_path(path) as temporary:
        (_write_obj if path.suffix.lower() == ".obj" else _write_ply)(temporary, mesh)


def _write_ply(path: Path, mesh: Mesh) -> None:
    columns = [mesh.vertices, mesh.normals]
    names = ["x", "y", "z", "nx", "ny", "nz"]
    if mesh.uv is not None:
        columns.append(mesh.uv)
        names += ["u", "v"]

    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(mesh.vertices)}"]
    header += [f"property float {name}" for name in names]
    header.append(f"element face {len(mesh.faces)}")
    header.append("property list uchar int vertex_indices")
    header.append("end_header")
    head = ("\n".join(header) + "\n").encode()

    faces = np.empty(len(mesh.faces), [("count", "u1"), ("corners", "<i4", 3)])
    faces["count"] = 3
    faces["corners"] = mesh.faces
    path.write_bytes(head + np.concatenate(columns, 1).astype("<f4").tobytes() + faces.tobytes())


def _write_obj(path: Path, mesh: Mesh) -> None:
    lines = [f"v {x:.7g} {y:.7g} {z:.7g}" for x, y, z in mesh.vertices]
    lines += [f"vn {x:.5f} {y:.5f} {z:.5f}" for x, y, z in mesh.normals]
    if mesh.uv is not None:
        lines += [f"vt {u:.7f} {v:.7f}" for u, v in mesh.uv]
    corner = "{0}/{0}/{0}" if mesh.uv is not None else "{0}//{0}"
    lines += ["f " + " ".join(corner.format(i) for i in face) for face in mesh.faces + 1]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
