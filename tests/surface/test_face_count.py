"""How many triangles a surface needs: a ball, whose distance to its triangles is known."""

import numpy as np
import pytest

from pipeline.base.config import parse_scene
from pipeline.base.runtime import import_open3d
from pipeline.geometry.mesh_io import Mesh, vertex_normals
from pipeline.report.choices import triangles_choice
from pipeline.surface.face_count import FEWER, FEWEST, Seen, as_few_faces, pixels_apart

RADIUS = 0.5
AWAY = 3.0  # of the cameras from the ball's middle


def ball(subdivisions=5, center=(0.0, 0.0, 0.0)):
    """20 * 4^subdivisions triangles whose corners lie on the ball."""
    ico = import_open3d().geometry.TriangleMesh.create_icosahedron().subdivide_loop(subdivisions)
    vertices = np.asarray(ico.vertices)
    vertices = RADIUS * vertices / np.linalg.norm(vertices, axis=1, keepdims=True) + center
    faces = np.asarray(ico.triangles).astype(np.int64)
    return Mesh(vertices, faces, vertex_normals(vertices, faces))


def test_surfaces_are_as_far_apart_as_they_are_moved(ring):
    views = ring(8, 64, AWAY)
    moved = Seen(ball(4, (0, 0.02, 0)), views)
    apart = pixels_apart(Seen(ball(4), views), moved)
    most = 0.02 * views[0].fx / (AWAY - RADIUS)  # what faces the move, at the ball's near side
    assert 0.7 * most < apart <= most
    assert pixels_apart(moved, moved) == pytest.approx(0, abs=1e-3)


def test_larger_photos_ask_for_more_triangles_and_get_what_they_ask_for(ring):
    dense = ball()
    counts = []
    for size in (64, 256):
        views = ring(8, size, AWAY)
        richest, kept, found = as_few_faces(dense, 8000, views, 0.1)
        assert len(richest.faces) == pytest.approx(8000, rel=0.01)

        middles = kept.vertices[kept.faces].mean(1)  # where a triangle is furthest from the ball
        pixel = (AWAY - RADIUS) / views[0].fx
        off = np.abs(np.linalg.norm(middles, axis=1) - RADIUS) / pixel
        assert np.quantile(off, 0.9) < 0.12
        tried = [faces for faces, _ in found["attempts"]]
        assert tried == sorted(tried, reverse=True) and len(kept.faces) in tried
        counts.append(len(kept.faces))
    assert counts[1] > 1.5 * counts[0] > FEWEST


def test_a_surface_that_is_never_close_enough_keeps_all_triangles(ring):
    views = ring(8, 64, AWAY)
    richest, kept, found = as_few_faces(ball(), 8000, views, 1e-6)
    assert kept is richest and len(found["attempts"]) == 1


def test_without_a_tolerance_nothing_is_chosen(ring):
    richest, kept, found = as_few_faces(ball(), 3000, ring(8, 64, AWAY), 0.0)
    assert kept is richest and found["attempts"] == []


def test_the_fewest_triangles_are_always_there(ring):
    _, kept, _ = as_few_faces(ball(), 8000, ring(8, 64, AWAY), 10.0)
    assert FEWEST / FEWER < len(kept.faces) < FEWEST * FEWER


@pytest.mark.parametrize(
    "own", [{"mesh": {"faces": 9000}}, {"choose": {"enabled": False}}, {"mesh": {"face_error": 0}}]
)
def test_who_says_how_many_triangles_gets_them(own):
    assert parse_scene({"photos": "p"} | own, "x.yaml").mesh.face_error == 0


def test_a_scene_may_ask_for_both():
    own = {"photos": "p", "mesh": {"faces": 9000, "face_error": 0.3}}
    assert parse_scene(own, "x.yaml").mesh.face_error == 0.3
    assert parse_scene({"photos": "p"}, "x.yaml").mesh.face_error > 0


def test_the_report_says_how_many_and_what_fewer_would_cost():
    tried = [(30000, 0.12), (15000, 0.24), (10600, 0.31)]
    chosen = triangles_choice({"tolerance": 0.25, "most": 30000, "attempts": tried})
    assert chosen[0].chosen == "15000 of 30000"
    assert "within 0.24 pixels" in chosen[0].why and "with 10600 it is 0.31" in chosen[0].why
    all_needed = triangles_choice({"tolerance": 0.25, "most": 30000, "attempts": [(30000, 0.4)]})
    assert all_needed[0].chosen == "30000 of 30000" and "within 0.40" in all_needed[0].why
    assert triangles_choice({}) == []
