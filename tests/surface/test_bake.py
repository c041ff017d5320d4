"""Normal maps: what decimation took from a surface, in frames that every renderer shares."""

from dataclasses import replace

import numpy as np
import pytest

from pipeline.base.config import Atlas
from pipeline.base.errors import InputError
from pipeline.geometry.mesh_io import Mesh, load_mesh, save_mesh, unit
from pipeline.geometry.normal_maps import (
    face_tangents,
    frames_of,
    mirrored_share,
    read_normal_map,
    write_normal_map,
)
from pipeline.surface.atlas import make_atlas, unwrap
from pipeline.surface.bake import bake, make_normal_map
from pipeline.surface.raster import texel_faces
from tests.conftest import sphere
from tests.seeds import numpy_rng

degrees_between = lambda a, b: np.degrees(np.arccos(np.clip((unit(a) * unit(b)).sum(1), -1, 1)))


def looked_up(folder, count=4000):
    """Points (n, 3) on a decimated surface, its own normals and those of its map there, by nearest
    texel.
    """
    mesh = load_mesh(folder / "mesh_uv.ply")
    image = read_normal_map(folder / "normal.png") * 2 - 1
    face, weight = texel_faces(mesh, len(image))
    rows, columns = np.nonzero(face >= 0)
    chosen = numpy_rng(0).choice(len(rows), count)
    rows, columns = rows[chosen], columns[chosen]
    corners, weight = mesh.faces[face[rows, columns]], weight[rows, columns]
    blend = lambda values: np.einsum("kc,kcx->kx", weight, values[corners])

    own = unit(blend(mesh.normals))
    frame = frames_of(face_tangents(mesh)[0][face[rows, columns]], own)
    mapped = np.einsum("kij,ki->kj", frame, unit(image[rows, columns]))
    return blend(mesh.vertices), own, mapped


def test_map_brings_back_the_normals_of_the_dense_surface(bumpy):
    """The dense surface's normals by central differences of its radius, not by its mesh."""
    from tests.conftest import bumpy_normals

    where, own, mapped = looked_up(bumpy)
    truth = bumpy_normals(unit(where))
    assert np.median(degrees_between(own, truth)) > 6
    assert np.median(degrees_between(mapped, truth)) < 1.5
    assert np.percentile(degrees_between(mapped, truth), 95) < 4


def test_a_surface_that_lost_nothing_has_a_flat_map():
    mesh, _ = unwrap(sphere(3), Atlas(resolution=64))
    normals, facts = bake(mesh, mesh, 64, 2)
    assert facts["found_share"] == 1 and facts["median_tilt"] < 0.02
    assert np.abs(normals - [0, 0, 1]).max() < 1e-3


def test_the_back_of_a_thin_part_is_not_taken_for_its_front():
    """A plate a hundredth thick, whose dense surface is missing on top: the underside lies within
    reach, but faces away.
    """
    square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    up, down = np.tile([0, 0, 1.0], (4, 1)), np.tile([0, 0, -1.0], (4, 1))
    top = Mesh(square, faces, up, square[:, :2])
    tilted = unit(down + [0.3, 0, 0])
    _, facts = bake(top, Mesh(square - [0, 0, 0.01], faces[:, ::-1], tilted), 16, 0)
    assert facts["found_share"] == 0 and facts["median_tilt"] == 0
    normals, facts = bake(top, Mesh(square - [0, 0, 0.01], faces, -tilted), 16, 0)
    assert facts["found_share"] == 1
    assert np.allclose(normals[8, 8], unit(np.array([[-0.3, 0, 1]])), atol=1e-6)


def test_padding_holds_the_nearest_charts_normal(bumpy):
    mesh = load_mesh(bumpy / "mesh_uv.ply")
    image = read_normal_map(bumpy / "normal.png") * 2 - 1
    covered = texel_faces(mesh, len(image))[0] >= 0
    beside = ~covered & np.roll(covered, 1, 1)  # one texel to the right of a chart
    assert np.abs(image[beside] - np.roll(image, 1, 1)[beside]).mean() < 0.05
    assert (np.abs(image - [0, 0, 1]).max(-1) > 0.1)[beside].mean() > 0.3
    assert (np.abs(image - [0, 0, 1]).max(-1) < 1e-4).mean() > 0.2  # far from all charts


def test_charts_are_not_mirrored():
    unwrapped = unwrap(sphere(4), Atlas(resolution=256))[0]
    assert mirrored_share(unwrapped) < 1e-6
    assert unwrapped.uv is not None
    assert mirrored_share(replace(unwrapped, uv=unwrapped.uv[:, ::-1])) > 0.99


def mikk_tangents(mesh) -> np.ndarray:
    """MikkTSpace's vertex tangents (n, 3): the faces' ones in the vertex's tangent plane, weighted
    by the face's angle there (Mikkelsen 2008, section 2.4), for an atlas without mirrored charts.
    """
    along = unit(face_tangents(mesh)[0])
    total = np.zeros_like(mesh.vertices)
    for corner in range(3):
        here, one, other = (mesh.faces[:, (corner + k) % 3] for k in range(3))
        normal = mesh.normals[here]
        sides = [
            unit(in_plane(mesh.vertices[end] - mesh.vertices[here], normal)) for end in (one, other)
        ]
        angle = np.radians(degrees_between(*sides))
        np.add.at(total, here, angle[:, None] * unit(in_plane(along, normal)))
    return unit(total)


def in_plane(v, normal):
    """v (n, 3) without its part along `normal`."""
    return v - (v * normal).sum(1, keepdims=True) * normal


def test_frames_agree_with_mikktspace(bumpy):
    """A normal 10 degrees off, decoded in both frames, differs by the atlas's distortion only.
    Blender and glTF leave normal and tangent unnormalised between vertices.
    """
    mesh = load_mesh(bumpy / "mesh_uv.ply")
    rng = numpy_rng(0)
    face = rng.integers(len(mesh.faces), size=5000)
    weight = rng.dirichlet([1, 1, 1], 5000)
    blend = lambda values: np.einsum("kc,kcx->kx", weight, values[mesh.faces[face]])
    turn = rng.uniform(0, 2 * np.pi, 5000)
    tilt = np.radians(10)
    local = np.stack(
        [np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.full(5000, np.cos(tilt))], 1
    )
    ours = np.einsum(
        "kij,ki->kj", frames_of(face_tangents(mesh)[0][face], unit(blend(mesh.normals))), local
    )
    normal, tangent = blend(mesh.normals), blend(mikk_tangents(mesh))
    theirs = np.einsum(
        "kij,ki->kj", np.stack([tangent, np.cross(normal, tangent), normal], 1), local
    )
    assert np.median(degrees_between(ours, theirs)) < 0.4
    assert np.percentile(degrees_between(ours, theirs), 95) < 2.5


def test_sixteen_bits_survive_the_disk(tmp_path):
    normals = unit(numpy_rng(0).normal(size=(64, 3)) + [0, 0, 3]).reshape(8, 8, 3)
    write_normal_map(tmp_path / "normal.png", normals)
    assert np.abs(read_normal_map(tmp_path / "normal.png") * 2 - 1 - normals).max() < 2 / 65535
    (tmp_path / "normal.png").write_bytes(b"no picture")
    with pytest.raises(InputError, match="16-bit"):
        read_normal_map(tmp_path / "normal.png")


def test_where_there_is_no_map_the_metrics_say_why(tmp_path, bumpy):
    mesh = load_mesh(bumpy / "mesh_uv.ply")
    save_mesh(tmp_path / "mesh.ply", mesh)
    make_atlas(tmp_path / "mesh.ply", tmp_path, Atlas(resolution=64))
    assert "given" in make_normal_map(tmp_path, tmp_path, Atlas())["normal_map"]
    off = make_normal_map(bumpy, tmp_path, Atlas(normal_map=False))
    assert off == {"normal_map": "none: atlas.normal_map is off"}
    save_mesh(
        tmp_path / "mesh_uv.ply",
        Mesh(mesh.vertices, mesh.faces, mesh.normals, 1 - mesh.uv[:, ::-1]),
    )
    assert "mirrors 100 %" in make_normal_map(bumpy, tmp_path, Atlas())["normal_map"]
    assert not (tmp_path / "normal.png").exists()


def test_a_map_that_explains_nothing_is_not_written(tmp_path):
    """A fine ball and the same in fewer triangles: smooth normals show no difference. One that has
    lost bumps has a map (`bumpy`).
    """
    save_mesh(tmp_path / "dense.ply", sphere(6))
    save_mesh(tmp_path / "mesh.ply", sphere(5))
    make_atlas(tmp_path / "mesh.ply", tmp_path, Atlas(resolution=64))
    found = make_normal_map(tmp_path, tmp_path, Atlas(resolution=64))
    assert found["normal_map"].startswith("none: decimation moved normals by less than 0.5 degrees")
    assert not (tmp_path / "normal.png").exists()
