"""Charts of a lumpy surface, and their packing."""

import numpy as np
import pytest

from pipeline.base.config import Atlas
from pipeline.base.errors import InputError
from pipeline.base.runtime import import_open3d
from pipeline.geometry.mesh_io import Mesh, vertex_normals
from pipeline.surface.atlas import judge, unwrap
from pipeline.surface.charts import adjacency, cut, flattened
from pipeline.surface.pack import packed
from tests.seeds import numpy_rng

SQUARE = (np.array([[0, 0], [1, 0], [1, 1], [0, 1.0]]), np.array([[0, 1, 2], [0, 2, 3]]))


def lumpy_ball():
    ico = import_open3d().geometry.TriangleMesh.create_icosahedron().subdivide_loop(3)
    vertices = np.asarray(ico.vertices)
    vertices = vertices / np.linalg.norm(vertices, axis=1, keepdims=True)
    vertices = vertices * (1 + numpy_rng(0).normal(0, 0.02, (len(vertices), 1)))
    faces = np.asarray(ico.triangles).astype(np.int64)
    return Mesh(vertices, faces, vertex_normals(vertices, faces))


@pytest.mark.slow
def test_lumps_do_not_become_charts():
    mesh = lumpy_ball()
    found, charts = unwrap(mesh, Atlas(resolution=256, padding=2))
    facts = judge(found.uv, found.faces, 512)
    assert charts <= 12
    assert facts["in_range"] and facts["overlap"] < 2e-3 and facts["utilisation"] > 0.55
    assert np.allclose(found.vertices[found.faces], mesh.vertices[mesh.faces])

    corners = found.uv[found.faces]
    one, other = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    assert (one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0] > 0).all()  # none is mirrored


@pytest.mark.slow
def test_each_triangle_is_in_one_chart():
    mesh = lumpy_ball()
    charts = flattened(mesh.vertices, mesh.faces, cut(mesh.vertices, mesh.faces))
    members = np.sort(np.concatenate([c.members for c in charts]))
    assert (members == np.arange(len(mesh.faces))).all()


def test_neighbours_across_edges():
    faces = np.array([[0, 1, 2], [2, 1, 3], [4, 5, 6]])
    assert (adjacency(faces) == [[-1, 1, -1], [0, -1, -1], [-1, -1, -1]]).all()


def test_packed_squares_keep_their_distance():
    resolution, padding = 128, 4
    places = packed([SQUARE] * 9, resolution, padding)
    side = [np.ptp(uv, axis=0) * resolution for uv in places]
    assert np.allclose(side, side[0][0]) and side[0][0] > 28
    for k, one in enumerate(places):
        assert one.min() > 0 and one.max() < 1
        for other in places[:k]:
            apart = np.maximum(one.min(0) - other.max(0), other.min(0) - one.max(0)).max()
            assert apart * resolution >= padding


def test_too_many_charts_for_the_texels_are_refused():
    with pytest.raises(InputError, match="do not fit"):
        packed([SQUARE] * 300, 16, 4)
