"""The scene's own mesh: read whatever program has written it, checked, and set right."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from pipeline.base.apart import module_environment
from pipeline.base.errors import InputError
from pipeline.geometry.cameras import Rig
from pipeline.geometry.mesh_io import Mesh, load_mesh, unit, vertex_normals
from pipeline.surface.preview import Silhouette

NAMES = ("mesh.ply", "mesh.obj")
MOST_FACES = 2_000_000
TEXTURED = re.compile(r"property\s+\w+\s+(u|s)\s")
LEAST_BYTES = {"vertex": 3, "face": 4}  # of a PLY's entries; most take more
HEAD = 4096  # bytes of a PLY that surely hold its header
LOOK = 96  # long side in pixels at which it is tried whether photos look at the mesh
ALL = 0.995  # of all pixels covered: the cameras stand inside
EXPORT = "export it again as binary PLY or OBJ with triangles"


def given_mesh(scene: Path, rig: Rig) -> Mesh | None:
    """The scene's own mesh in the library frame, or None. Raises InputError where it cannot be used
    with these cameras.
    """
    path = next((scene / name for name in NAMES if (scene / name).exists()), None)
    if path is None:
        return None
    if rig.source == "sfm":
        raise InputError(
            "a mesh is given, but no cameras: the two cannot be brought together",
            path,
            "add transforms.json or sparse/0 in the mesh's frame, or remove the mesh",
        )

    mesh = set_right(read_given(path), path)
    world = np.array(rig.facts["world"])
    linear = world[:3, :3]
    turn = linear / np.cbrt(np.linalg.det(linear))
    vertices = mesh.vertices @ linear.T + world[:3, 3]
    mesh = Mesh(vertices, mesh.faces, mesh.normals @ turn.T, mesh.uv)
    check_seen(mesh, rig, path)
    return mesh


def read_given(path: Path) -> Mesh:
    """The file's triangles as they are; polygons are cut into triangles. Raises InputError."""
    if path.suffix.lower() == ".ply":
        return _read_ply(path)
    # indices that count from the end, which Mitsuba's reader does not know
    from_end = re.search(rb"^f[^\n]*[ /]-\d", path.read_bytes(), re.MULTILINE)
    return _by_open3d(path) if from_end else load_mesh(path)


def _read_ply(path: Path) -> Mesh:
    """A PLY by Open3D, whole: its reader stops at the first damaged face without an error."""
    head = path.open("rb").read(HEAD).decode("latin-1").split("end_header")[0]
    claimed = {kind: int(n) for kind, n in re.findall(r"element\s+(vertex|face)\s+(\d+)", head)}
    if claimed.get("face", 0) > MOST_FACES:
        raise InputError(
            f"{claimed['face']} triangles, more than {MOST_FACES}",
            path,
            "decimate it; a normal map can carry what is lost",
        )
    least = sum(LEAST_BYTES[kind] * count for kind, count in claimed.items())
    size = path.stat().st_size
    if least > size:  # else the reader would ask for that much memory
        raise InputError(f"{size} bytes are too few for {claimed}", path, EXPORT)

    mesh = _by_open3d(path)
    if len(mesh.faces) < claimed.get("face", 0) or len(mesh.vertices) < claimed.get("vertex", 0):
        raise InputError(
            f"{len(mesh.vertices)} vertices and {len(mesh.faces)} triangles could be read of "
            f"{claimed.get('vertex', 0)} and {claimed.get('face', 0)}: the file is damaged",
            path,
            EXPORT,
        )
    if not TEXTURED.search(head):
        return mesh

    # Open3D leaves texture coordinates out, and Mitsuba's reader crashes on corners that are none
    _check_corners(mesh, path)
    uv = load_mesh(path).uv
    if uv is not None and len(uv) != len(mesh.vertices):
        raise InputError(
            f"{len(uv)} texture coordinates for {len(mesh.vertices)} vertices", path, EXPORT
        )
    return replace(mesh, uv=uv)


def _by_open3d(path: Path) -> Mesh:
    """The file's triangles by a process of their own (read_mesh_file.py)."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "mesh.npz"
        command = [sys.executable, "-m", "pipeline.surface.read_mesh_file", str(path), str(out)]
        environment = module_environment()
        done = subprocess.run(command, capture_output=True, env=environment, check=False)
        if done.returncode < 0:
            name = signal.Signals(-done.returncode).name
            raise InputError(f"damaged: its reader crashed on it ({name})", path, EXPORT)
        if done.returncode:
            last = done.stderr.decode(errors="replace").strip().splitlines()[-1:]
            raise InputError(f"not a readable mesh ({' '.join(last)})", path, EXPORT)
        with np.load(out) as found:
            vertices, faces, normals = found["vertices"], found["faces"], found["normals"]
    if len(normals) != len(vertices):
        normals = np.zeros_like(vertices)  # `set_right` makes them
    return Mesh(vertices, faces, normals)


def set_right(mesh: Mesh, path: Path) -> Mesh:
    """Without triangles that have no area and vertices that no triangle uses; a closed surface with
    its outside out; normals where the file has none. Raises InputError where it is no surface.
    """
    if not len(mesh.faces):
        raise InputError("there are no triangles in it", path, EXPORT)
    if len(mesh.faces) > MOST_FACES:
        raise InputError(
            f"{len(mesh.faces)} triangles, more than {MOST_FACES}", path, "decimate it"
        )
    if not np.isfinite(mesh.vertices).all():
        raise InputError("NaN or infinity among its vertices", path, EXPORT)
    _check_corners(mesh, path)
    if mesh.uv is not None and not np.isfinite(mesh.uv).all():
        raise InputError("NaN or infinity among its texture coordinates", path, EXPORT)

    corners = mesh.vertices[mesh.faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    faces = mesh.faces[np.linalg.norm(cross, axis=1) > 0]
    if not len(faces):
        raise InputError("none of its triangles has an area", path, EXPORT)
    used, faces = np.unique(faces, return_inverse=True)
    faces = faces.reshape(-1, 3)
    vertices, normals = mesh.vertices[used], mesh.normals[used]
    uv = None if mesh.uv is None else mesh.uv[used]

    if inside_out(vertices, faces):
        faces = faces[:, ::-1]
    own = vertex_normals(vertices, faces)
    usable = np.isfinite(normals).all(1) & (np.linalg.norm(normals, axis=1) > 0.1)
    usable &= (normals * own).sum(1) > 0  # a normal that looks into the object is a mistake
    return Mesh(vertices, faces, np.where(usable[:, None], unit(normals), own), uv)


def _check_corners(mesh: Mesh, path: Path) -> None:
    """InputError for a triangle with a corner that is no vertex."""
    if len(mesh.faces) and (mesh.faces.min() < 0 or mesh.faces.max() >= len(mesh.vertices)):
        raise InputError("a triangle has a corner that is no vertex", path, EXPORT)


def inside_out(vertices: np.ndarray, faces: np.ndarray) -> bool:
    """Whether the triangles of a closed surface face inward: its volume is negative. Of an open one
    the volume about its middle says the same, unless it is nearly flat.
    """
    centred = vertices - vertices.mean(0)
    corners = centred[faces]
    return float(np.einsum("ni,ni->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2]))) < 0


def check_seen(mesh: Mesh, rig: Rig, path: Path) -> None:
    """InputError unless some photos look at the mesh, from outside of it."""
    if not rig.views:
        return
    silhouette = Silhouette(mesh)
    small = [v.scaled(min(1.0, LOOK / max(v.width, v.height))) for v in rig.views]
    shares = [float(silhouette(v).mean()) for v in small]
    if max(shares) == 0:
        raise InputError(
            "no pixel of the photos looks at it: it lies elsewhere, or is far too small",
            path,
            "give it in the frame and units of the cameras (docs/scene_folder.md)",
        )
    if np.mean(shares) > ALL:
        raise InputError(
            f"it covers {100 * np.mean(shares):.1f} % of the photos: the cameras are inside",
            path,
            "give the object alone, in the cameras' frame and units (docs/scene_folder.md)",
        )
