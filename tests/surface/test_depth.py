"""Depth by PatchMatch: against surfaces of known shape, painted with noise."""

import cv2
import numpy as np
import pytest

from pipeline.geometry.cameras import View
from pipeline.geometry.mesh_io import Mesh, vertex_normals
from pipeline.surface.depth import HullRange, Photos, depth_maps, neighbours, scale_for
from pipeline.surface.patch_match import BEST, SAMPLES, WORST, Plane, carried, patch_at, plane_cost
from tests.conftest import look_at
from tests.seeds import numpy_rng, seeded

SIZE = (160, 120)


def box(low, high):
    """A closed box as a mesh, faces outward."""
    corners = np.array(np.meshgrid(*zip(low, high), indexing="ij")).reshape(3, -1).T
    quads = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    faces = np.array([[q[0], q[a], q[a + 1]] for q in quads for a in (1, 2)])
    return Mesh(corners.astype(float), faces, vertex_normals(corners.astype(float), faces))


def cameras():
    """Two rows of cameras before the plane z = 0."""
    width, height = SIZE
    eyes = [[0.45 * (k % 3) - 0.45, 0.4 * (k // 3), 2.0] for k in range(6)]
    return [
        View(f"v{k}", "", width, height, 190, 190, width / 2, height / 2, look_at(eye))
        for k, eye in enumerate(eyes)
    ]


def pictures(views, slope, contrast=4.0):
    """The plane z = slope x, painted with noise, as each view sees it; grey in [0, 1]."""
    rng = numpy_rng(0)
    paint = cv2.GaussianBlur(rng.uniform(0, 1, (700, 700)).astype(np.float32), (0, 0), 1.5)
    paint = np.clip((paint - paint.mean()) * contrast + 0.5, 0, 1)
    out = []
    for v in views:
        u, w = np.meshgrid(np.arange(v.width) + 0.5, np.arange(v.height) + 0.5)
        o, d = v.rays(np.stack([u, w], -1))
        along = (slope * o[..., 0] - o[..., 2]) / (d[..., 2] - slope * d[..., 0])
        p = o + d * along[..., None]
        x = (p[..., 0] * 200 + 350).astype(np.float32)
        y = (p[..., 1] * 200 + 350).astype(np.float32)
        out.append(cv2.remap(paint, x, y, cv2.INTER_LINEAR))
    return out


def world_points(depth):
    """Points (n, 3) of a depth map and their normals (n, 3) in the world."""
    rows, columns = np.nonzero(depth.depth)
    o, d = depth.view.rays(np.stack([columns + 0.5, rows + 0.5], -1))
    along = depth.depth[rows, columns] / (d @ depth.view.world_to_camera[2, :3])
    turned = depth.normal[rows, columns] @ depth.view.world_to_camera[:3, :3]
    return o + d * along[:, None], turned


@pytest.mark.slow
@pytest.mark.parametrize("slope", [0.0, 0.6])
def test_depth_and_normals_of_a_painted_plane(slope):
    views = cameras()
    hull = box([-0.5, -0.4, -0.45], [0.5, 0.4, 0.45])
    depths, share = depth_maps(views, pictures(views, slope), hull, 0.05, 10**6, 2)
    assert share > 0.4

    true = np.array([-slope, 0, 1]) / np.hypot(1, slope)
    for depth in depths:
        points, normals = world_points(depth)
        assert np.median(np.abs(points @ true)) < 0.006  # half a pixel is .005
        assert np.degrees(np.median(np.arccos(np.clip(normals @ true, -1, 1)))) < 8


def test_a_plane_is_given_up_only_where_it_is_no_better():
    """Planes right and wrong against a limit: below it the cost is what it is without one, else it
    is WORST or no less than the limit; some are given up before all photos are looked at.
    """
    views = cameras()
    photos = Photos.at(views, pictures(views, 0.0))
    others = photos.others(1, [0, 2, 3, 4, 5], None)
    space, costs = np.empty((2, SAMPLES), np.float32), np.empty(5, np.float32)
    patch = patch_at(photos.images[1], *SIZE, 80, 60, *space)
    rng, limit, given_up = numpy_rng(1), np.float32(0.2), 0
    for wrong in (0.0, 0.002, 0.01, 0.05, 0.1, 0.2):
        leaning = np.array([0, 0, -1]) + wrong * rng.normal(size=3)
        normal = (leaning / np.linalg.norm(leaning)).astype(np.float32)
        plane = Plane(np.float32(2 * (1 + wrong * rng.normal())), *normal)
        whole = plane_cost(patch, plane, photos.cameras[1], others, costs)
        assert whole == pytest.approx(np.sort(costs)[:BEST].mean(), abs=1e-6)
        found = plane_cost(patch, plane, photos.cameras[1], others, costs, limit)
        assert found == whole if whole < limit else found >= limit
        given_up += found == WORST and whole < WORST
    assert given_up > 0


@pytest.mark.slow
def test_a_plane_without_paint_has_no_depth():
    views = cameras()
    hull = box([-0.5, -0.4, -0.45], [0.5, 0.4, 0.45])
    blank = [np.full(SIZE[::-1], 0.5, np.float32)] * len(views)
    _, share = depth_maps(views, blank, hull, 0.05, 10**6, 2)
    assert share < 0.02


@pytest.mark.slow
def test_same_seed_same_depth_whatever_the_threads():
    views = cameras()[:4]
    images = pictures(views, 0.3)
    hull = box([-0.3, -0.3, -0.3], [0.3, 0.3, 0.3])
    maps = [depth_maps(views, images, hull, 0.05, 10**4, n, seed=seeded(3))[0] for n in (1, 2)]
    for one, two in zip(*maps):
        assert (one.depth == two.depth).all() and (one.normal == two.normal).all()


def test_close_ups_are_scaled_to_the_budget():
    views = cameras()
    assert scale_for(views, [10_000.0] * 6, 60_000) == 1.0
    assert scale_for(views, [10_000.0] * 6, 15_000) == pytest.approx(0.5)
    assert scale_for(views, [10_000.0] * 6, 1) == pytest.approx(48 / 120)  # never smaller
    assert scale_for(views, [1.0] * 6, 60_000) == 1.0  # nor enlarged


def test_range_of_depth_is_that_of_the_hull_and_what_shows_through_it():
    view = View("v", "", 60, 60, 60, 60, 30, 30, look_at([0, 0, 4.0]))
    near, far = HullRange(box([-0.5] * 3, [0.5] * 3), 0.1)(view)
    assert near[30, 30] == pytest.approx(3.4, abs=0.02)
    beyond = 4.5 + 0.1 + 0.25 * np.sqrt(3)
    assert far[30, 30] == pytest.approx(beyond, abs=0.02)
    assert near[0, 0] == far[0, 0] == 0


def test_ground_behind_the_hull_is_searched_too():
    view = View("v", "", 60, 60, 60, 60, 30, 30, look_at([0, 3.0, 3.0]))
    _, far = HullRange(box([-0.3] * 3, [0.3] * 3), 0.0, ground=-0.5)(view)
    assert far[30, 30] == pytest.approx(3.5 * np.sqrt(2), rel=0.02)


def test_a_plane_carried_to_another_pixel_is_the_same_plane():
    camera = np.array([100, 100, 50, 40, 100, 80], np.float32)
    normal = np.array([0.3, -0.2, -0.9])
    normal = (normal / np.linalg.norm(normal)).astype(np.float32)
    point = lambda x, y, z: z * np.array([(x + 0.5 - 50) / 100, (y + 0.5 - 40) / 100, 1])
    plane = carried(2.0, normal, 20, 30, 33, 41, camera)
    assert isinstance(plane, Plane)
    first = point(20, 30, 2.0) @ normal
    assert point(33, 41, plane.z) @ normal == pytest.approx(first, rel=1e-5)


def test_neighbours_are_neither_too_near_nor_too_far():
    near = neighbours(cameras(), np.zeros(3), 5)
    assert all(k not in row and row for k, row in enumerate(near))
