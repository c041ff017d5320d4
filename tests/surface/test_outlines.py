"""A hull drawn taut over its masks' outlines."""

import numpy as np
import pytest

from pipeline.geometry.cameras import Rig
from pipeline.geometry.mesh_io import unit
from pipeline.surface.clean import to_mesh
from pipeline.surface.outlines import rim
from pipeline.surface.silhouettes import silhouettes_of
from pipeline.surface.taut import taut
from pipeline.surface.zbuffer import Crop, z_buffer
from tests.surface.test_surface import silhouettes

RADIUS = 0.5


def hull_of_ball(views):
    """The hull of a ball's masks, and the masks."""
    masks = silhouettes(views, RADIUS)
    seen = silhouettes_of(Rig(views, np.zeros(3), 0.8, "transforms.json"), masks, set(masks), True)
    grid = seen.grid(64)
    return to_mesh(seen.hull(grid, seen.tolerance), grid), [masks[v.name] for v in views]


def tilt(mesh):
    """Degrees (n,) between the normals and those of a ball at the origin."""
    return np.degrees(np.arccos((mesh.normals * unit(mesh.vertices)).sum(-1).clip(-1, 1)))


def disagreement(mesh, views, masks):
    """Share of the masks' pixels in which the mesh's pictures differ from them."""
    wrong = total = 0
    for view, mask in zip(views, masks):
        crop = Crop(0, 0, view.width, view.height, view.K, *pose(view))
        shown = z_buffer(crop, mesh.vertices, mesh.faces)[1] >= 0
        wrong += (shown != mask).sum()
        total += mask.sum()
    return wrong / total


def pose(view):
    return view.world_to_camera[:3, :3], view.world_to_camera[:3, 3]


@pytest.mark.slow
def test_creases_between_rims_go_and_outlines_stay(ring):
    views = ring(24, 160)
    hull, masks = hull_of_ball(views)
    drawn = taut(hull, views, masks, threads=2)
    assert np.array_equal(drawn.faces, hull.faces)
    seen = np.abs(hull.vertices[:, 1]) < 0.3  # from above and below no camera looks
    assert tilt(drawn)[seen].mean() < 0.6 * tilt(hull)[seen].mean()
    assert disagreement(drawn, views, masks) <= disagreement(hull, views, masks) + 0.002


def test_an_edge_far_from_the_outline_does_not_pull(ring):
    """One mask that lacks half of the ball: what it lacks is not taken away."""
    views = ring(24, 160)
    hull, masks = hull_of_ball(views)
    halved = [masks[0] & (np.arange(160) > 80), *masks[1:]]
    moved = taut(hull, views, halved, threads=1).vertices - taut(hull, views, masks, 1).vertices
    assert np.linalg.norm(moved, axis=1).max() < 0.03 * RADIUS


def test_the_rim_is_what_borders_on_nothing_within_the_frame():
    covered = np.zeros((6, 6), bool)
    covered[1:4, 2:] = True
    expected = covered.copy()
    expected[2, 3:] = False  # inside
    expected[:, -1] = False  # the frame ends
    assert np.array_equal(rim(covered), expected)
