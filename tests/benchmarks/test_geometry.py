"""Meshes and normals against truth: similarities, angles seen by cameras, pictures of normals."""

import json

import cv2
import numpy as np
import pytest

from benchmarks.geometry import Similarity, compare, icp, normal_errors, umeyama
from benchmarks.normals import NormalCaster, angles, picture_scores, read_normals
from pipeline.base.errors import InputError
from pipeline.base.images import linear_to_srgb, write_png
from pipeline.geometry.cameras import Y_FROM_Z_UP, Rig, save_cameras
from pipeline.geometry.mesh_io import Mesh, load_mesh, save_mesh, unit
from tests.seeds import numpy_rng

HERE = Similarity(1.0, np.eye(3), np.zeros(3))


def turn(degrees, axis=2):
    """A rotation matrix about a coordinate axis."""
    cosine, sine = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    first, second = [k for k in range(3) if k != axis]
    out = np.eye(3)
    out[[first, second], [first, second]] = cosine
    out[first, second], out[second, first] = -sine, sine
    return out


def round_ball(ball):
    """The ball with the normals of a true sphere."""
    mesh = load_mesh(ball / "mesh.ply")
    return Mesh(mesh.vertices, mesh.faces, unit(mesh.vertices))


def test_a_similarity_is_found_again():
    points = numpy_rng(0).normal(size=(50, 3))
    made = Similarity(1.7, turn(30, 0) @ turn(-50, 1), np.array([1.0, -2.0, 0.5]))
    found = umeyama(points, made.points(points))
    np.testing.assert_allclose(found.points(points), made.points(points), atol=1e-12)

    both = made.then(found)
    np.testing.assert_allclose(both.points(points), found.points(made.points(points)), atol=1e-12)
    assert np.linalg.norm(both.directions(points), axis=1) == pytest.approx(
        np.linalg.norm(points, axis=1)
    )


def test_icp_undoes_a_small_motion():
    points = numpy_rng(0).random((400, 3)) * [1, 2, 3]
    moved = Similarity(1.0, turn(1.0), np.array([0.01, 0.0, -0.01])).points(points)
    motion = icp(moved, points, limit=0.2)
    np.testing.assert_allclose(motion.points(moved), points, atol=1e-6)


def test_tilted_normals_are_as_wrong_as_they_are_tilted(ball, ring):
    mesh = round_ball(ball)
    truth = NormalCaster(mesh)
    same = normal_errors(truth, truth, HERE, ring(4), above=-np.inf)
    assert len(same) > 1000 and same.max() < 0.1

    # each normal tilted by 10 degrees towards a direction of its own, at right angles to it
    aside = unit(np.cross(mesh.normals, [0.3, 1.0, -0.2]))
    tilted = np.cos(np.radians(10)) * mesh.normals + np.sin(np.radians(10)) * aside
    cast = NormalCaster(Mesh(mesh.vertices, mesh.faces, tilted))
    error = normal_errors(cast, truth, HERE, ring(4), above=-np.inf)
    assert np.median(error) == pytest.approx(10, abs=0.3)


def test_normals_are_compared_in_the_truths_frame(ball, ring):
    """A mesh and cameras, moved together, have the same angles to the truth; truth that lies below
    the height does not count.
    """
    mesh = round_ball(ball)
    move = Similarity(2.0, turn(40, 1) @ turn(20, 0), np.array([3.0, 0.0, 1.0]))
    truth = Mesh(move.points(mesh.vertices), mesh.faces, move.directions(mesh.normals))
    casters = NormalCaster(mesh), NormalCaster(truth)
    whole = normal_errors(*casters, move, ring(4), above=-np.inf)
    half = normal_errors(*casters, move, ring(4), above=0.0)
    assert whole.max() < 0.1
    assert 0.3 < len(half) / len(whole) < 0.9


@pytest.mark.slow
def test_a_true_mesh_has_no_error(tmp_path, ball, ring):
    views = ring(6)
    save_cameras(tmp_path / "cameras.json", Rig(views, np.zeros(3), 0.6, "given"))
    frames = [
        {"file_path": f"images/{v.name}.png", "transform_matrix": np.linalg.inv(v.world_to_camera)}
        for v in views
    ]
    text = json.dumps({"frames": frames}, default=np.ndarray.tolist)
    (tmp_path / "truth.json").write_text(text)
    mesh = ball / "mesh.ply"
    files = (mesh, tmp_path / "cameras.json", mesh, tmp_path / "truth.json")
    found = compare(*files, points=60_000)
    assert found["f1_at_1_percent_of_size"] > 0.99
    assert found["normal_error_median_degrees"] < 0.1
    assert found["camera_error_median_percent"] < 1e-6

    # a ball larger by 2 % of its size all round
    big = load_mesh(mesh)
    save_mesh(tmp_path / "big.ply", Mesh(1.04 * big.vertices, big.faces, big.normals))
    found = compare(tmp_path / "big.ply", *files[1:], points=60_000)
    assert found["f1_at_1_percent_of_size"] < 0.05
    assert found["chamfer_percent_of_diagonal"] == pytest.approx(2 / 3**0.5, rel=0.1)


def test_what_lies_below_shifts_nothing(tmp_path, ball, ring):
    """A ball on whose underside a shallow foot stands in place of the cap."""
    views = ring(6)
    rng = numpy_rng(0)
    frames = []
    for view in views:
        pose = np.linalg.inv(view.world_to_camera)
        pose[:3, 3] += rng.normal(0, 1e-3, 3)
        frames.append({"file_path": f"images/{view.name}.png", "transform_matrix": pose.tolist()})
    save_cameras(tmp_path / "cameras.json", Rig(views, np.zeros(3), 0.6, "sfm"))
    (tmp_path / "truth.json").write_text(json.dumps({"frames": frames}))

    true = load_mesh(ball / "mesh.ply")
    low = true.vertices[:, 1] < -0.25
    raised = true.vertices + np.where(low, 0.02, 0)[:, None] * [0, 1, 0]
    save_mesh(tmp_path / "found.ply", Mesh(raised, true.faces, true.normals))
    files = (ball / "mesh.ply", tmp_path / "truth.json")
    here = (tmp_path / "found.ply", tmp_path / "cameras.json")
    whole = compare(*here, *files, points=30_000)
    above = compare(*here, *files, above=-0.15, points=30_000)
    assert above["accuracy_median_percent"] < 0.6 * whole["accuracy_median_percent"]


def test_pictures_of_normals(tmp_path, ball, ring):
    """Blender's pictures of a ball, as NeRF-synthetic scenes have them, fit the ball's mesh."""
    views = ring(6, 96)
    (tmp_path / "test").mkdir()
    for k, view in enumerate(views):
        u, v = np.meshgrid(np.arange(96) + 0.5, np.arange(96) + 0.5)
        origins, directions = view.rays(np.stack([u, v], -1))
        near = -(origins * directions).sum(-1)
        inside = near**2 - (origins**2).sum(-1) + 0.25
        points = origins + (near - np.sqrt(np.maximum(inside, 0)))[..., None] * directions
        normals = np.where(inside[..., None] > 0, 2 * points, 0) @ Y_FROM_Z_UP[:3, :3]
        stem = tmp_path / "test" / f"r_{k}"
        pixels = np.round(linear_to_srgb(normals) * 255).astype(np.uint8)
        write_png(stem.with_name(f"r_{k}_normal.png"), pixels)

        view.name = f"test_r_{k}"
        true, whole = read_normals(stem.with_name(f"r_{k}_normal.png"))
        error = angles(unit(true[whole]), 2 * points[whole])
        assert (error < 8).all()

    save_cameras(tmp_path / "cameras.json", Rig(views, np.zeros(3), 0.6, "given"))
    found = picture_scores(ball / "mesh.ply", tmp_path / "cameras.json", tmp_path)
    assert found["normal_pixels"] > 300
    assert found["normal_error_median_degrees"] < 3


def test_a_mesh_far_from_the_truth_is_refused():
    points = numpy_rng(0).random((50, 3))
    with pytest.raises(InputError, match="not near"):
        icp(points + 5, points, limit=0.1)


@pytest.mark.parametrize("channels", [(1, 0), (0, 1), (-0.5, 0.5)])
@pytest.mark.parametrize("turned", [0, 90])
@pytest.mark.parametrize("bits", [8, 16])
def test_a_normal_map_tilts_the_normals(tmp_path, channels, turned, bits):
    """A floor whose u goes along x, or along -z, where v goes along x: red tilts along u, green
    along v.
    """
    corners = np.array([[-1, 0, 1], [1, 0, 1], [1, 0, -1], [-1, 0, -1.0]])
    uv = np.array([[0, 0], [1, 0], [1, 1], [0, 1.0]])
    along_u, along_v = np.array([1.0, 0, 0]), np.array([0, 0, -1.0])
    if turned:
        uv, along_u, along_v = np.roll(uv, 1, 0), along_v, -along_u
    floor = Mesh(corners, np.array([[0, 1, 2], [0, 2, 3]]), np.tile([0, 1.0, 0], (4, 1)), uv)
    save_mesh(tmp_path / "mesh_uv.ply", floor)

    red, green = 0.3 * np.array(channels)
    blue = np.sqrt(1 - red**2 - green**2)
    full = 2**bits - 1
    pixel = np.round((np.array([blue, green, red]) / 2 + 0.5) * full)  # OpenCV's order
    picture = np.broadcast_to(pixel, (16, 16, 3)).astype(f"uint{bits}")
    cv2.imwrite(str(tmp_path / "normal.png"), picture)

    origins = np.array([[0.2, 3.0, 0.4], [-0.5, 3.0, -0.3], [5.0, 3.0, 0.0]])
    cast = NormalCaster.of_file(tmp_path / "mesh_uv.ply")
    hit, points, normals = cast(origins, np.tile([0, -1.0, 0], (3, 1)))
    assert hit.tolist() == [True, True, False]
    np.testing.assert_allclose(points, origins[:2] * [1, 0, 1], atol=1e-6)
    expected = red * along_u + green * along_v + blue * np.array([0, 1.0, 0])
    np.testing.assert_allclose(normals, np.tile(expected, (2, 1)), atol=1.5 / full + 1e-6)
