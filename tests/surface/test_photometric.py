"""Photometric refinement on a ball seen by eight cameras, with and without texture."""

from dataclasses import replace

import numpy as np
import pytest

from pipeline.base.runtime import import_open3d
from pipeline.geometry.cameras import View
from pipeline.geometry.mesh_io import Mesh, unit, vertex_normals
from pipeline.surface.consistency import CHANCE, Sight, knowledge, pull, with_slopes
from pipeline.surface.photometric import (
    ASLANT,
    RIM,
    Refinement,
    _front,
    _gather,
    refine_mesh,
)
from pipeline.surface.pictures import affordable, at_size
from pipeline.surface.plate import umbrella
from pipeline.surface.zbuffer import Crop, z_buffer
from tests.conftest import look_at
from tests.seeds import numpy_rng

SIZE = 96
RADIUS = 0.5
NEIGHBOURS = [[(k - 1) % 8, (k + 1) % 8] for k in range(8)]
QUICK = Refinement(scales=(0.5, 1.0), steps=(4, 5))


def cameras():
    """Eight on a ring of 25 degrees' steps, so that neighbours see much alike."""
    out = []
    for k in range(8):
        angle = np.radians(25 * k)
        eye = 2.2 * np.array([np.sin(angle), 0.3, np.cos(angle)])
        pose = look_at(eye)
        out.append(View(f"v{k}", "", SIZE, SIZE, 170, 170, SIZE / 2, SIZE / 2, pose))
    return out


def points_on_ball(view):
    """Where each pixel's ray meets the true ball (h, w, 3), nan where it misses."""
    u, v = np.meshgrid(np.arange(view.width) + 0.5, np.arange(view.height) + 0.5)
    o, d = view.rays(np.stack([u, v], -1))
    b = (o * d).sum(-1)
    root = b**2 - (o**2).sum(-1) + RADIUS**2
    far = np.where(root > 0, -b - np.sqrt(np.maximum(root, 0)), np.nan)
    return o + d * far[..., None]


def texture(p):
    """A pattern without edges, waves of about six pixels."""
    rng = numpy_rng(3)
    waves = 45 * rng.normal(size=(12, 3))
    waves /= np.maximum(np.linalg.norm(waves, axis=1, keepdims=True) / 45, 1)
    value = np.sin(p @ waves.T + rng.uniform(0, 6, 12)).sum(-1)
    return 0.5 + 0.06 * value


def photos(views, paint):
    return [np.nan_to_num(paint(points_on_ball(v)), nan=0.1) for v in views]


def bumpy_ball():
    """The ball with long bumps of 3 % of its radius, and the directions of its vertices."""
    ico = import_open3d().geometry.TriangleMesh.create_icosahedron().subdivide_loop(5)
    on = unit(np.asarray(ico.vertices))
    bumps = 1 + 0.03 * np.sin(9 * on[:, :1] + 1) * np.sin(8 * on[:, 1:2])
    vertices = RADIUS * bumps * on
    faces = np.asarray(ico.triangles).astype(np.int64)
    return Mesh(vertices, faces, vertex_normals(vertices, faces))


def error(vertices, where):
    """Median distance to the ball, as a share of its radius."""
    return float(np.median(np.abs(np.linalg.norm(vertices[where], axis=1) / RADIUS - 1)))


def well_seen(mesh):
    """Vertices that face the arc of cameras' middle."""
    angle = np.radians(87.5)
    return mesh.vertices @ [np.sin(angle), 0.3, np.cos(angle)] > 0.6 * RADIUS


@pytest.mark.slow
def test_textured_ball_comes_close_to_the_truth():
    mesh = bumpy_ball()
    views = cameras()
    where = well_seen(mesh)
    refined = refine_mesh(mesh, views, photos(views, texture), NEIGHBOURS, QUICK)
    scores = [step["score"] for step in refined.facts["steps"]]
    # a texture's own agreement at the start is .93 to .96; what is missing to 1 falls by a fifth
    assert 1 - scores[-1] < 0.8 * (1 - scores[0]) and scores[-1] > 0.95
    assert error(refined.mesh.vertices, where) < 0.4 * error(mesh.vertices, where)
    assert (refined.mesh.faces == mesh.faces).all()


@pytest.mark.slow
def test_plain_ball_gets_no_worse():
    """One colour and weak noise: the photos know nothing of the surface."""
    mesh = bumpy_ball()
    views = cameras()
    rng = numpy_rng(0)
    noisy = [
        p + rng.normal(0, 0.003, p.shape) for p in photos(views, lambda p: p[..., 0] * 0 + 0.5)
    ]
    refined = refine_mesh(mesh, views, noisy, NEIGHBOURS, QUICK).mesh
    everywhere = np.ones(len(mesh.vertices), bool)
    assert error(refined.vertices, everywhere) < 1.02 * error(mesh.vertices, everywhere)


@pytest.mark.slow
def test_change_of_exposure_changes_nothing():
    """But for a few windows of little contrast, which count before the change or after it."""
    mesh = bumpy_ball()
    views = cameras()
    few = Refinement(scales=(1.0,), steps=(2,))
    images = photos(views, texture)
    darker = [(0.9 - 0.02 * k) * image + 0.01 * k for k, image in enumerate(images)]
    one = refine_mesh(mesh, views, images, NEIGHBOURS, few).mesh
    other = refine_mesh(mesh, views, darker, NEIGHBOURS, few).mesh
    moved = np.abs(one.vertices - mesh.vertices).max()
    apart = np.abs(one.vertices - other.vertices).max(1)
    assert (apart > 0.01 * moved).mean() < 0.1


def test_pull_is_the_slope_of_the_score():
    """Against the change of all windows' scores, each weighted by what it knows, when the surface
    goes deeper everywhere.
    """
    views = cameras()[:2]
    images = photos(views, texture)

    def sight(k, deeper):
        crop = Crop.around(views[k], np.array([[-0.6] * 3, [0.6] * 3]), 0)
        points = points_on_ball(views[k])
        _, depth = views[k].project(points)
        front = np.isfinite(depth)
        aslant = (np.nan_to_num(points) * (views[k].position - np.nan_to_num(points))).sum(-1)
        front &= aslant > 0.6 * RADIUS * 2
        depth = np.where(front, depth + 0.01 + deeper, 0).astype(np.float32)
        whole = Crop(0, 0, SIZE, SIZE, views[k].K, crop.rotation, crop.shift)
        return Sight(whole, with_slopes(images[k]), depth, front, 0.1)

    other = sight(1, 0.0)
    first, second, score = pull(sight(0, 0.0), other)
    step = 1e-3
    scores = lambda deeper: pull(sight(0, deeper), other)[2]
    weight = np.vectorize(knowledge)(np.nan_to_num(score))
    slope = np.nansum(weight * (scores(step) - scores(-step))) / (2 * step)  # seen both times
    assert np.isfinite(score).sum() > 500 and (second >= 0).all()
    assert abs(first.sum() - slope) < 0.05 * abs(slope)


def test_windows_count_by_what_their_score_tells_of_a_shift():
    """Nothing up to chance, then more and more steeply, but never without bound."""
    known = np.array([knowledge(score) for score in np.linspace(CHANCE, 0.95, 40)])
    assert (np.diff(known, 2) > 0).all()
    assert knowledge(0.9 * CHANCE) == knowledge(-1.0) == 0
    assert knowledge(1.0) == pytest.approx(0.98**2 / (1 - 0.98**2))


def test_a_pixels_pull_is_shared_by_its_place_in_the_triangle():
    """A camera looks along z at a triangle across. One of its vertices moves at 60 degrees to that:
    half of its movement is the surface's.
    """
    share = np.array([0.5, 0.3, 0.2])
    a, b = np.array([1.0, 0.2]), np.array([-0.5, -1.0])
    corners = np.stack([a, b, -(share[0] * a + share[1] * b) / share[2]])  # the pixel's ray: (0, 0)
    x = np.column_stack([corners, np.full(3, 2.0)])
    normals = np.array([[0, 0, -1.0], [0, 0, -1.0], [np.sqrt(0.75), 0, -0.5]])
    first, second, depth = (np.full((1, 1), value, np.float32) for value in (3, 5, 2))
    rays = np.array([[1, 0, -0.5], [0, 1, -0.5], [0, 0, 1.0]])
    seen, faces = np.zeros((1, 1), int), np.array([[0, 1, 2]])
    flat = np.array([[0, 0, -1.0]])
    g, h = _gather(first, second, depth, seen, x, faces, flat, normals, rays, np.zeros(3))
    lever = np.array([1, 1, 0.5])
    np.testing.assert_allclose(g, -3 * share * lever)  # outwards is towards the camera
    np.testing.assert_allclose(h, 5 * share * lever**2)


@pytest.mark.parametrize(
    "cosine, seen", [(1.0, True), (ASLANT + 0.01, True), (ASLANT - 0.01, False)]
)
def test_surfaces_aslant_and_beside_an_outline_are_not_looked_at(cosine, seen):
    """Half of the picture is near, half is far: depth jumps from column 9 to column 10."""
    depth = np.ones((12, 20), np.float32)
    depth[:, 10:] = 2
    flat = np.array([[np.sqrt(1 - cosine**2), 0, -cosine]])
    rays = np.array([[0, 0, 0], [0, 0, 0], [0, 0, 1.0]])  # all along z
    front = _front(depth, np.zeros(depth.shape, int), flat, rays, 1e-3)
    expected = np.zeros(depth.shape, bool)
    expected[RIM:-RIM, RIM:-RIM] = seen
    expected[:, 10 - RIM : 10 + RIM] = False
    assert (front == expected).all()


@pytest.mark.slow
def test_outlines_pull_where_nothing_else_does():
    """A plain ball that is too small grows to its masks' edges, but not where no view has a say."""
    ball, views = bumpy_ball(), cameras()
    small = Mesh(0.97 * RADIUS * unit(ball.vertices), ball.faces, unit(ball.vertices))
    masks = [np.isfinite(points_on_ball(v)[..., 0]) for v in views]
    plain = [np.full((SIZE, SIZE), 0.5)] * 8
    gap = lambda mesh: np.median(RADIUS - np.linalg.norm(mesh.vertices, axis=1)[well_seen(mesh)])
    drawn = refine_mesh(small, views, plain, NEIGHBOURS, QUICK, masks).mesh
    unseen = refine_mesh(small, views, plain, NEIGHBOURS, QUICK, [None] * 8).mesh
    assert gap(drawn) < 0.5 * gap(small) < gap(unseen)


def test_z_buffer_is_what_rays_hit():
    mesh = bumpy_ball()
    view = cameras()[0]
    crop = Crop.around(view, mesh.vertices, 3)
    depth, seen = z_buffer(crop, mesh.vertices, mesh.faces)
    assert ((depth > 0) == (seen >= 0)).all()

    from pipeline.surface.preview import caster

    scene, o3d = caster(mesh)
    u, v = np.meshgrid(np.arange(crop.width) + 0.5, np.arange(crop.height) + 0.5)
    o, d = view.rays(np.stack([u + crop.left, v + crop.top], -1))
    hit = scene.cast_rays(o3d.core.Tensor(np.concatenate([o, d], -1).astype(np.float32)))
    along = hit["t_hit"].numpy() * (d @ view.world_to_camera[2, :3])
    both = np.isfinite(along) & (depth > 0)
    assert (np.isfinite(along) != (depth > 0)).mean() < 2e-3
    assert np.abs(depth - along)[both].max() < 1e-3


def test_umbrella_of_a_flat_fan_is_zero():
    ring = np.radians(np.arange(6) * 60)
    vertices = np.concatenate([[[0, 0, 0]], np.stack([np.cos(ring), np.sin(ring), 0 * ring], -1)])
    faces = np.array([[0, 1 + k, 1 + (k + 1) % 6] for k in range(6)])
    assert np.abs((umbrella(8, faces) @ np.pad(vertices, ((0, 1), (0, 0))))[[0, 7]]).max() < 1e-12


def test_cost_is_bounded_by_smaller_images():
    mesh = bumpy_ball()
    views = cameras()
    images = [np.zeros((SIZE, SIZE))] * 8
    assert affordable(mesh, views, images, 1e9) == 1
    factor = affordable(mesh, views, images, 8000)
    boxes = [Crop.around(v, mesh.vertices, 0) for v in views]
    assert sum(b.width * b.height for b in boxes) * factor**2 == pytest.approx(8000)


def test_lists_must_match_the_views():
    mesh = bumpy_ball()
    views = cameras()
    images = [np.zeros((SIZE, SIZE))] * 8
    with pytest.raises(ValueError, match="one entry per view"):
        refine_mesh(mesh, views, images[1:], NEIGHBOURS)
    with pytest.raises(ValueError, match="its own neighbour"):
        refine_mesh(mesh, views, images, [[0]] * 8)
    with pytest.raises(ValueError, match="no reduced picture"):
        refine_mesh(mesh, views, [np.zeros((40, 50))] * 8, NEIGHBOURS)


def test_pictures_whose_sides_are_rounded_are_reduced_pictures():
    """675 x 1200 pixels at half their size are 338 x 600."""
    view = replace(cameras()[0], width=675, height=1200)
    small = at_size(view, np.zeros((600, 338), np.float32))
    assert (small.width, small.height) == (338, 600)
    assert small.fx == pytest.approx(view.fx * 338 / 675)
    assert small.fy == pytest.approx(view.fy / 2)
