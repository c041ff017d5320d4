"""Sheets of pictures: what a view sees of normals and maps."""

import numpy as np
import pytest

from benchmarks.look import cropped, grey, map_seen, normals_seen
from benchmarks.normals import NormalCaster
from pipeline.geometry.mesh_io import Mesh, load_mesh, unit
from pipeline.render.observe import Tracer


@pytest.fixture
def view(ring):
    return ring(1, 64)[0]


def test_normals_are_colours(view, ball):
    """In the middle of a ball the normal points at the camera; beside it the picture is black."""
    mesh = load_mesh(ball / "mesh.ply")
    round_mesh = Mesh(mesh.vertices, mesh.faces, unit(mesh.vertices))
    seen = normals_seen(view, NormalCaster(round_mesh))
    to_camera = view.position / np.linalg.norm(view.position)
    np.testing.assert_allclose(seen[31:33, 31:33].mean((0, 1)), (to_camera + 1) * 127.5, atol=3)
    assert seen[0, 0].max() == 0


def test_maps_are_seen_through_the_atlas(view, ball):
    tracer = Tracer(ball / "mesh_uv.ply")
    rows = np.linspace(1, 0, 256, dtype=np.float32)  # v at each row's centre, nearly
    shown = map_seen(view, tracer, np.repeat(rows[:, None, None], 256, 1))
    uv, _, hit = tracer.hit(*view.rays(np.array([[20.5, 30.5]])))
    assert hit.all()
    assert shown[30, 20, 0] == pytest.approx(uv[0, 1], abs=0.01)
    assert shown[0, 0, 0] == 0


def test_tiles_are_cut_to_the_object():
    mask = np.zeros((100, 80), bool)
    mask[40:60, 3:20] = True
    tile = np.zeros((100, 80, 3), np.uint8)
    tile[mask] = 9
    small = cropped([tile, tile], mask)
    assert [t.shape for t in small] == [(35, 27, 3)] * 2
    assert small[0].sum() == tile.sum()


def test_scalars_are_grey():
    assert grey(np.full((1, 1, 1), 0.5)).tolist() == [[[128, 128, 128]]]
