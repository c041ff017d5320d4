"""Charts of a lumpy surface, and their packing."""

import gc
import warnings

import numpy as np
import pytest
import xatlas
from scipy import ndimage, sparse
from scipy.sparse.csgraph import connected_components

from pipeline.base.apart import apart
from pipeline.base.config import Atlas
from pipeline.base.errors import InputError
from pipeline.base.runtime import import_open3d
from pipeline.geometry.mesh_io import Mesh, vertex_normals
from pipeline.surface import xatlas_page
from pipeline.surface.atlas import doublings, evened, flat_charts, judge, unwrap
from pipeline.surface.charts import (
    adjacency,
    cut,
    flattened,
    joined_charts,
    laid_flat,
)
from pipeline.surface.pack import COARSE, DENSITY, FITS, NEAR, Page, _best_turns, _packed, packed
from pipeline.surface.raster import rasterize
from tests.seeds import numpy_rng

SQUARE = (np.array([[0, 0], [1, 0], [1, 1], [0, 1.0]]), np.array([[0, 1, 2], [0, 2, 3]]))


def lumpy_ball(subdivisions=3, lumps=0.02):
    """A ball whose vertices are moved in and out by `lumps` of its radius, each by itself."""
    ico = import_open3d().geometry.TriangleMesh.create_icosahedron().subdivide_loop(subdivisions)
    vertices = np.asarray(ico.vertices)
    vertices = vertices / np.linalg.norm(vertices, axis=1, keepdims=True)
    vertices = vertices * (1 + numpy_rng(0).normal(0, lumps, (len(vertices), 1)))
    faces = np.asarray(ico.triangles).astype(np.int64)
    return Mesh(vertices, faces, vertex_normals(vertices, faces))


def islands(mesh):
    """Charts as the mesh's corners join them."""
    one, other = mesh.faces.ravel(), np.roll(mesh.faces, -1, axis=1).ravel()
    links = sparse.coo_matrix((np.ones(len(one)), (one, other)), (len(mesh.vertices),) * 2)
    return connected_components(links, directed=False)[0]


@pytest.mark.slow
def test_lumps_do_not_become_regions():
    """Before regions are joined, which mends much: 10 to 23 for forty seeds, and 68 to 84 where
    triangles' normals are not evened.
    """
    mesh = lumpy_ball(4)
    assert len(np.unique(cut(mesh.vertices, mesh.faces))) <= 40


@pytest.mark.slow
def test_lumps_do_not_become_charts():
    """2 to 4 charts for sixteen seeds; 12 to 20 where the surface is not evened before the cut."""
    mesh = lumpy_ball(4, 0.05)
    found, charts = unwrap(mesh, Atlas(resolution=256, padding=2))
    facts = judge(found.uv, found.faces, 512)
    assert charts == islands(found) <= 8
    # two discs fill .54 of a square; these charts are ragged
    assert facts["in_range"] and facts["overlap"] == 0 and facts["utilisation"] > 0.35
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


def shape(rng, cells):
    """A ragged chart: the cells of a grid that a random walk visits, each of two triangles."""
    at, seen = np.zeros(2, int), {(0, 0)}
    while len(seen) < cells:
        at = at + np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])[rng.integers(4)]
        seen.add(tuple(at))
    corners = np.array(sorted(seen))[:, None] + [[0, 0], [1, 0], [1, 1], [0, 1]]
    uv, index = np.unique(corners.reshape(-1, 2), axis=0, return_inverse=True)
    square = index.reshape(-1, 4)
    return uv.astype(float), np.concatenate([square[:, [0, 1, 2]], square[:, [0, 2, 3]]])


def shapes():
    rng = numpy_rng(1)
    return [shape(rng, cells) for cells in (60, 40, 40, 20, 12, 8, 5, 3, 2, 1, 1)]


def areas(uv, corner):
    one, other = uv[corner[:, 1]] - uv[corner[:, 0]], uv[corner[:, 2]] - uv[corner[:, 0]]
    return 0.5 * (one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0])


@pytest.mark.parametrize("padding", [1, 4])
def test_ragged_charts_keep_their_distance_and_side(padding):
    """As many free texels as the padding says, across the page's edges too, where a texture that
    repeats goes on; no chart is mirrored or overlaps another.
    """
    resolution = 128
    charts = shapes()
    places = packed(charts, resolution, padding)
    covered = [rasterize(uv, corner, resolution) for uv, (_, corner) in zip(places, charts)]
    assert np.max(covered) == 1
    for k, one in enumerate(covered):
        others = np.sum(covered[:k] + covered[k + 1 :], axis=0)
        around = ndimage.distance_transform_cdt(np.tile(others, (3, 3)) == 0, "chessboard")
        middle = around[resolution : 2 * resolution, resolution : 2 * resolution]
        assert middle[one > 0].min() > padding
    for uv, (_, corner) in zip(places, charts):
        assert (areas(uv, corner) > 0).all()
        assert uv.min() * resolution >= padding / 2 and (1 - uv.max()) * resolution >= padding / 2
        assert (rasterize(uv, corner, resolution) > 0).any()


def test_charts_of_a_long_and_of_small_ones_have_one_scale():
    """The long one asks for the page's width; each side is a whole number of texels, so that the
    scale differs by what rounds a side of 5 texels up.
    """
    long = (SQUARE[0] * [24, 1], SQUARE[1])
    charts = [long] + [SQUARE] * 5
    places = packed(charts, 128, 2)
    texels = [areas(uv, corner).sum() * 128**2 for uv, (_, corner) in zip(places, charts)]
    assert texels[0] / 24 == pytest.approx(texels[1], rel=0.25)
    assert np.ptp(places[0], axis=0).max() > 0.9


def test_packing_does_not_depend_on_the_unit():
    """xatlas leaves out triangles below 1.2e-7 in area, in whatever unit. (Where two turns of a
    chart make pages of one size, rounding decides between them.)
    """
    charts = shapes()
    tiny = packed([(1e-5 * uv, corner) for uv, corner in charts], 128, 2)
    areas_of = lambda places: [areas(uv, corner).sum() for uv, (_, corner) in zip(places, charts)]
    np.testing.assert_allclose(areas_of(tiny), areas_of(packed(charts, 128, 2)), rtol=0.1)
    assert np.max([rasterize(uv, c, 128) for uv, (_, c) in zip(tiny, charts)]) == 1


def test_chart_without_area_is_packed_beside_others():
    """xatlas places none of its triangles; it covers no texel."""
    needle = (np.array([[0, 0], [1, 0], [0.5, 0.0]]), np.array([[0, 1, 2]]))
    places = packed([*shapes(), needle], 128, 2)
    assert np.isfinite(places[-1]).all() and np.min(places[-1]) >= 0 and np.max(places[-1]) <= 1


def test_too_many_charts_for_the_texels_are_refused():
    with pytest.raises(InputError, match="do not fit"):
        packed([SQUARE] * 300, 16, 4)


@pytest.mark.parametrize("movable, left", [(0, 4), (1, 1), (4, 1)])
def test_charts_that_may_be_joined_find_neighbours(movable, left):
    """A flat strip of eight squares in four charts: all become one from the first chart on."""
    x = np.repeat(np.arange(9.0), 2)
    vertices = np.stack([x, np.tile([0.0, 1.0], 9), np.zeros(18)], 1)
    a = 2 * np.arange(8)
    faces = np.stack([a, a + 2, a + 3, a, a + 3, a + 1], 1).reshape(-1, 3)
    groups = [np.arange(4 * k, 4 * k + 4) for k in range(4)]
    flat = laid_flat(vertices, faces, groups, 256)
    charts = joined_charts(vertices, faces, flat, range(movable), 256)
    assert len(flat) == 4 and len(charts) == left
    assert sorted(np.concatenate([c.members for c in charts])) == list(range(16))


def test_ring_that_overlaps_itself_by_a_sliver_is_cut():
    """A turn and a thousandth of a helix: on its plane the ends lie over each other, in a few
    texels of a page.
    """
    angle = np.linspace(0, 2 * np.pi + 0.006, 80)
    inner, outer = (
        np.stack([r * np.cos(angle), r * np.sin(angle), 0.001 * angle], 1) for r in (0.7, 1)
    )
    k = np.arange(79)
    faces = np.concatenate([[k, k + 80, k + 81], [k, k + 81, k + 1]], 1).T
    charts = flattened(np.concatenate([inner, outer]), faces, np.zeros(158, int))
    assert len(charts) == 2
    for chart in charts:
        corner = np.searchsorted(chart.index, faces[chart.members])
        span = 1.01 * np.ptp(chart.uv, axis=0).max()
        count = rasterize((chart.uv - chart.uv.min(0)) / span, corner, 2048)
        assert count.max() == 1


def tetrahedron(shift):
    vertices = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1.0]]) * 0.2 + shift
    return vertices, np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]])


def test_closed_part_of_four_triangles_is_cut_open():
    """No border holds a closed part's relaxation: its equations are singular."""
    vertices, faces = tetrahedron(0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        charts = flattened(vertices, faces, np.zeros(4, int))
    assert sorted(np.concatenate([c.members for c in charts])) == [0, 1, 2, 3]
    assert len(charts) > 1 and all(np.isfinite(c.uv).all() for c in charts)


def test_chart_of_a_closed_and_an_open_part_is_cut():
    """Beside a part with a border: the closed part's equations are singular all the same."""
    square = np.array([[2, 0, 0], [3, 0, 0], [3, 1, 0], [2, 1, 0], [2.4, 0.4, 0.0]])
    fan = np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]])
    closed, faces = tetrahedron(0)
    both = np.concatenate([fan, faces + 5])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        charts = flattened(np.concatenate([square, closed]), both, np.zeros(8, int))
    assert sorted(np.concatenate([c.members for c in charts])) == list(range(8))
    assert all(np.isfinite(c.uv).all() for c in charts)


@pytest.mark.slow
def test_tetrahedron_beside_a_ball_gets_an_atlas():
    ball = lumpy_ball()
    vertices, faces = tetrahedron([3.0, 0, 0])
    vertices = np.concatenate([ball.vertices, vertices])
    faces = np.concatenate([ball.faces, faces + len(ball.vertices)])
    mesh = Mesh(vertices, faces, vertex_normals(vertices, faces))
    found = unwrap(mesh, Atlas(resolution=256, padding=2))[0]
    assert np.isfinite(found.uv).all()
    assert judge(found.uv, found.faces, 512)["overlap"] == 0

    laid = areas(found.uv, found.faces)
    true = np.linalg.norm(face_areas(mesh), axis=1)
    part = np.arange(len(faces)) >= len(ball.faces)
    share = lambda area: area[part].sum() / area.sum()
    # evening shrinks it to a 60,000th of its size; half of it, a quarter in area, is kept at least,
    # and a box's diagonal in space is up to 1.7 times that on the page
    assert share(laid) / share(true) > 0.25 / 1.7**2


def face_areas(mesh):
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    return np.cross(b - a, c - a)


def test_a_coarse_mesh_keeps_its_shape_on_the_page():
    """A box of long triangles: evening without a limit makes a ball of it, on whose page areas are
    off by more than a factor of two in the mean.
    """
    found = import_open3d().geometry.TriangleMesh.create_box(1.0, 0.6, 0.4).subdivide_midpoint(1)
    vertices = np.asarray(found.vertices)
    faces = np.asarray(found.triangles).astype(np.int64)
    mesh = Mesh(vertices, faces, vertex_normals(vertices, faces))
    ball = evened(mesh)
    assert doublings(mesh, flattened(ball, faces, cut(ball, faces))) > 1.0
    even, charts = flat_charts(mesh)
    assert doublings(mesh, charts) < 0.8
    assert np.abs(even - vertices).max() <= 0.0101 * np.linalg.norm([1.0, 0.6, 0.4])


def test_many_thin_charts_do_not_make_the_page_long():
    """Bars lie side by side: a page that begins empty grows longest where they are long."""
    bars = [(SQUARE[0] * [1, 0.02], SQUARE[1])] * 40
    places = packed(bars, 256, 2)
    page = np.ptp(np.concatenate(places), axis=0)
    assert page.min() > 0.8 * page.max()


def test_turns_that_make_the_page_too_wide_are_not_taken():
    """For such a page is shrunk in both directions until its width fits, however low it is."""
    boxes = [SQUARE[0] * [4, 1], SQUARE[0] * [3, 1], SQUARE[0] * [2, 1]]

    def as_if_placed(charts, corners, half, width):
        lies = all(np.ptp(uv[:, 0]) > np.ptp(uv[:, 1]) for uv in charts)
        return charts, (100, 100) if lies else (150, 50)

    page = Page(boxes, [SQUARE[1]] * 3, 100, 1, as_if_placed)
    turns, scale = _best_turns(page, numpy_rng(0))
    assert (turns % 2 == 0).all()
    area = sum(areas(uv, SQUARE[1]).sum() for uv in boxes)
    assert np.isclose(scale, (DENSITY * 100**2 / area) ** 0.5)


def test_other_turns_are_tried_where_the_page_holds_less_than_was_promised():
    """As the charts lie first, the page is too wide from .8 of the promised scale on."""
    boxes = [(SQUARE[0] * [k, 1], SQUARE[1]) for k in (2, 3, 4, 5)]
    resolution, padding = 1024, 4
    inner = resolution - padding
    side = lambda charts: max(np.ptp(uv, axis=0).max() for uv in charts)
    lying = lambda charts: [np.ptp(uv[:, 0]) > np.ptp(uv[:, 1]) for uv in charts]
    first = []

    def as_if_placed(charts, corners, half, width):
        if width <= COARSE:
            return charts, (COARSE, COARSE)
        first[:] = first or [side(charts), lying(charts)]
        wide = lying(charts) == first[1] and side(charts) > 0.8 * first[0]
        return charts, (inner + wide, inner)

    found = _packed(boxes, resolution, padding, as_if_placed)
    assert side(found) * resolution > NEAR * first[0]


def test_what_does_not_fit_on_the_coarse_page_is_not_tried_on_the_page_itself():
    """A coarse page that promises much in the search of turns, and then says no to all others: the
    page itself, eight times the work, has the tries of the scale only.
    """
    boxes = [(SQUARE[0] * [k, 1], SQUARE[1]) for k in (2, 3, 4, 5)]
    side = lambda charts: max(np.ptp(uv, axis=0).max() for uv in charts)
    on_the_page, after = [], []

    def as_if_placed(charts, corners, half, width):
        if width > COARSE:
            on_the_page.append(side(charts))
            most = 1020 if on_the_page[-1] < 0.5 * on_the_page[0] else 1021
            return charts, (most, most)
        if on_the_page:
            after.append(side(charts))
        return charts, (COARSE + len(on_the_page),) * 2

    _packed(boxes, 1024, 4, as_if_placed)
    assert len(on_the_page) <= FITS < len(after)


def atlases_destroyed_by_a_page():
    """How many atlases of xatlas `placed` has let go when it returns; called by `apart`, so that
    the one it keeps ends with that process.
    """
    ended = []

    class Noted(xatlas.Atlas):
        def __del__(self):
            ended.append(self)

    xatlas_page.xatlas.Atlas = Noted
    xatlas_page.placed([8 * SQUARE[0]], [SQUARE[1]], 1, 16)
    gc.collect()
    return len(ended)


def test_no_atlas_of_xatlas_is_destroyed():
    """Its destructor waits for its threads, and now and then for ever."""
    with apart("tests.surface.test_charts", "atlases_destroyed_by_a_page") as call:
        assert call() == 0


def test_this_process_makes_no_atlas_of_xatlas(monkeypatch):
    monkeypatch.delattr(xatlas_page.xatlas, "Atlas")
    assert len(packed([SQUARE] * 2, 64, 2)) == 2
