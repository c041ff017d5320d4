"""Cases of given meshes: without normals, with quads, damaged, inside out, endless, elsewhere."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from benchmarks.corpus.case import message, result
from benchmarks.corpus.project import RADIUS, Project, ball, obj_text
from pipeline.geometry.mesh_io import Mesh, load_mesh, save_mesh, unit, vertex_normals

GROUP = "mesh"
STAGES = ("capture", "poses", "masks", "mesh")


def is_the_ball(p: Project) -> None:
    mesh = load_mesh(p.work / "mesh" / "mesh.ply")
    radius = np.linalg.norm(mesh.vertices, axis=1)
    assert len(mesh.faces) > 200, f"{len(mesh.faces)} triangles"
    assert np.abs(radius - RADIUS).max() < 1e-3, f"radius {radius.min():.3f} to {radius.max():.3f}"
    corners = mesh.vertices[mesh.faces]
    outward = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert ((outward * corners.mean(1)).sum(1) > -1e-9).all(), "triangles face inward"
    assert ((mesh.normals * unit(mesh.vertices)).sum(1) > 0.9).all(), "normals do not face outward"


def ply(p: Project, vertices: np.ndarray, faces: list[list[int]], head: str = "") -> None:
    """An ASCII PLY in place of the mesh."""
    (p.scene / "mesh.obj").unlink(missing_ok=True)
    lines = ["ply", "format ascii 1.0", f"element vertex {len(vertices)}"]
    lines += [f"property float {axis}" for axis in "xyz"]
    lines += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header"]
    lines += [" ".join(f"{x:.7g}" for x in vertex) for vertex in vertices]
    lines += [" ".join(map(str, [len(face), *face])) for face in faces]
    (p.scene / "mesh.ply").write_text(head or "\n".join(lines) + "\n", encoding="utf-8")


def obj(p: Project, text: str) -> None:
    (p.scene / "mesh.obj").write_text(text, encoding="utf-8")


def quads() -> tuple[np.ndarray, list[list[int]]]:
    """The ball with the quads of its rings; triangles at the poles."""
    vertices, faces = ball()
    count = (len(faces) - 48) // 2
    joined = [[a, b, c, faces[count + k][2]] for k, (a, b, c) in enumerate(faces[:count].tolist())]
    return vertices, joined + faces[2 * count :].tolist()


@result(GROUP, "OBJ without normals", is_the_ball, stages=STAGES)
def obj_without_normals(p: Project) -> None:
    pass


@result(GROUP, "PLY without normals", is_the_ball, stages=STAGES)
def ply_without_normals(p: Project) -> None:
    vertices, faces = ball()
    ply(p, vertices, faces.tolist())


@result(GROUP, "OBJ with quads", is_the_ball, stages=STAGES)
def obj_quads(p: Project) -> None:
    vertices, faces = quads()
    obj(p, obj_text(vertices, faces))


@result(GROUP, "PLY with quads", is_the_ball, stages=STAGES)
def ply_quads(p: Project) -> None:
    ply(p, *quads())


@result(GROUP, "OBJ with indices that count from the end", is_the_ball, stages=STAGES)
def negative_indices(p: Project) -> None:
    vertices, faces = ball()
    obj(p, obj_text(vertices, faces - len(vertices) - 1))


@result(GROUP, "OBJ whose material is missing", is_the_ball, stages=STAGES)
def missing_material(p: Project) -> None:
    obj(p, "mtllib gone.mtl\nusemtl shiny\n" + obj_text(*ball()))


@result(GROUP, "inside out", is_the_ball, stages=STAGES)
def inside_out(p: Project) -> None:
    vertices, faces = ball()
    obj(p, obj_text(vertices, faces[:, ::-1]))


@result(GROUP, "inside out, with normals that face inward", is_the_ball, stages=STAGES)
def inside_out_with_normals(p: Project) -> None:
    vertices, faces = ball()
    (p.scene / "mesh.obj").unlink()
    faces = faces[:, ::-1]
    save_mesh(p.scene / "mesh.ply", Mesh(vertices, faces, vertex_normals(vertices, faces)))


@result(GROUP, "normals that are all zero", is_the_ball, stages=STAGES)
def zero_normals(p: Project) -> None:
    vertices, faces = ball()
    (p.scene / "mesh.obj").unlink()
    save_mesh(p.scene / "mesh.ply", Mesh(vertices, faces, np.zeros_like(vertices)))


@result(GROUP, "triangles without area among the others", is_the_ball, stages=STAGES)
def no_area(p: Project) -> None:
    vertices, faces = ball()
    obj(p, obj_text(vertices, np.concatenate([faces, [[5, 5, 9], [7, 7, 7]]])))


@result(GROUP, "vertices that no triangle uses, far away", is_the_ball, stages=STAGES)
def unused(p: Project) -> None:
    vertices, faces = ball()
    ply(p, np.concatenate([vertices, [[900.0, 0, 0]]]), faces.tolist())


REFUSED: list[tuple[str, Callable[[Project], None], tuple[str, ...]]] = [
    ("zero bytes", lambda p: obj(p, ""), ("mesh.obj",)),
    ("PLY of zero bytes", lambda p: ply(p, *_listed(), head=" "), ("mesh.ply",)),
    ("no triangles", lambda p: ply(p, ball()[0], []), ("mesh.ply", "triangles")),
    ("OBJ without triangles", lambda p: obj(p, "v 0 0 0\nv 1 0 0\n"), ("mesh.obj", "triangles")),
    ("NaN in a vertex", lambda p: ply(p, *_with(np.nan)), ("mesh.ply", "NaN")),
    ("infinity in a vertex", lambda p: ply(p, *_with(np.inf)), ("mesh.ply", "damaged")),
    ("a corner that is no vertex", lambda p: ply(p, *_corner(10**6)), ("mesh.ply", "vert")),
    ("a corner below zero", lambda p: ply(p, *_corner(-5)), ("mesh.ply", "vert")),
    (
        "an OBJ corner that is no vertex",
        lambda p: obj(p, obj_text(*ball()) + "f 1 2 999999\n"),
        ("mesh.obj",),
    ),
    ("a mesh elsewhere", lambda p: obj(p, _moved(50.0)), ("mesh.obj", "photos")),
    ("a mesh 1000 times as small", lambda p: obj(p, _scaled(1e-3)), ("mesh.obj", "photos")),
    ("a mesh that holds the cameras", lambda p: obj(p, _scaled(1e3)), ("mesh.obj", "photos")),
    ("PLY cut in the middle", lambda p: _cut(p), ("mesh.ply",)),
    ("a header of 4 000 000 000 vertices", lambda p: _claims(p, 4_000_000_000), ("mesh.ply",)),
    ("text instead of a mesh", lambda p: obj(p, "<html>404</html>"), ("mesh.obj",)),
]


def _listed() -> tuple[np.ndarray, list[list[int]]]:
    vertices, faces = ball()
    return vertices, faces.tolist()


def _with(value: float) -> tuple[np.ndarray, list[list[int]]]:
    vertices, faces = _listed()
    vertices[9, 1] = value
    return vertices, faces


def _corner(index: int) -> tuple[np.ndarray, list[list[int]]]:
    vertices, faces = _listed()
    faces[3][1] = index
    return vertices, faces


def _moved(by: float) -> str:
    vertices, faces = ball()
    return obj_text(vertices + [by, 0, 0], faces)


def _scaled(factor: float) -> str:
    vertices, faces = ball()
    return obj_text(factor * vertices, faces)


def _binary(p: Project) -> bytes:
    vertices, faces = ball()
    (p.scene / "mesh.obj").unlink()
    save_mesh(p.scene / "mesh.ply", Mesh(vertices, faces, unit(vertices)))
    return (p.scene / "mesh.ply").read_bytes()


def _cut(p: Project) -> None:
    data = _binary(p)
    (p.scene / "mesh.ply").write_bytes(data[: len(data) // 2])


def _claims(p: Project, count: int) -> None:
    data = _binary(p)
    own = len(ball()[0])
    changed = data.replace(f"vertex {own}".encode(), f"vertex {count}".encode())
    (p.scene / "mesh.ply").write_bytes(changed)


for _name, _spoil, _words in REFUSED:
    message(GROUP, _name, *_words, stages=STAGES)(_spoil)


def told(p: Project) -> None:
    assert "mesh.glb" in str(p.result("capture")["warnings"]), p.result("capture")["warnings"]


@result(GROUP, "of a format that is not read", told)
def other_format(p: Project) -> None:
    (p.scene / "mesh.obj").rename(p.scene / "mesh.glb")


@message(
    GROUP,
    "5 million triangles",
    "mesh.ply",
    "5",
    "decimate",
    stages=STAGES,
    heavy=True,
    timeout=120,
)
def five_million(p: Project) -> None:
    vertices, faces = ball(1120)
    (p.scene / "mesh.obj").unlink()
    save_mesh(p.scene / "mesh.ply", Mesh(vertices, faces, unit(vertices)))
