"""What depth maps carve off a sphere is solid where its masks ask for it."""

from dataclasses import replace

import numpy as np
import pytest

from pipeline.surface.clean import to_mesh
from pipeline.surface.depth import Depth
from pipeline.surface.filling import LEAST_ASKING, carved_solids, without_seen_through
from pipeline.surface.silhouettes import silhouettes_of
from tests.surface.test_surface import sphere

sphere = sphere  # the fixture: a rig around a sphere, and its masks


@pytest.fixture
def scene(sphere):
    """What the masks say, a grid, the hull on it, and the hull without its right quarter."""
    rig, masks = sphere
    seen = silhouettes_of(rig, masks, set(masks), given=True)
    grid = seen.grid(40)
    hull = seen.hull(grid, 0.0)
    carved = hull.copy()
    carved[3 * grid.shape[0] // 4 :] = -0.5
    return seen, grid, hull, carved


def depth_of_plane(view, height):
    """A depth map of the level plane at y = `height`, on which three photos agree."""
    origin, direction = view.rays(view.pixel_centers())
    along = (height - origin[..., 1]) / direction[..., 1]
    depth = np.where(along > 0, along * (direction @ view.world_to_camera[2, :3]), 0)
    facing = np.broadcast_to(np.float32([0, 0, -1]), (*depth.shape, 3))
    agreeing = np.where(along > 0, 3, 0).astype(np.float32)
    return Depth(view, depth.astype(np.float32), facing, agreeing)


def test_a_part_that_masks_ask_for_is_solid(scene):
    """Cells by the cut, which the rest hides in most photos, need not be: the outline is filled."""
    seen, grid, hull, carved = scene
    free = np.zeros(grid.shape)
    solid = carved_solids(carved, hull, free, [], grid, seen)
    lost = (hull > 0) & (carved < 0)
    assert solid.sum() > 0.4 * lost.sum() > 100 and not solid[~lost].any()
    covered = lambda field: sum(int(c.sum()) for c in seen.covered(to_mesh(field, grid)))
    whole = covered(hull)
    assert whole - covered(np.where(solid, hull, carved)) < (whole - covered(carved)) / 5


def test_what_depth_maps_look_through_is_not_solid(scene):
    """As many as there are masks."""
    seen, grid, hull, carved = scene
    free = np.full(grid.shape, len(seen.small))
    assert not carved_solids(carved, hull, free, [], grid, seen).any()


def test_a_pit_that_no_outline_shows_stays(scene):
    """As depth alone can show it."""
    seen, grid, hull, _ = scene
    pit = hull.copy()
    x, y, z = (n // 2 for n in grid.shape)
    pit[x - 3 : x + 3, y:, z - 3 : z + 3] = -0.5
    lost = (hull > 0) & (pit < 0)
    solid = carved_solids(pit, hull, np.zeros(grid.shape), [], grid, seen)
    assert solid.sum() < 0.1 * lost.sum()


def test_one_or_two_masks_are_not_enough(scene):
    """Only as many masks as may be wrong have the part; the others end where the depth maps do."""
    seen, grid, hull, carved = scene
    left = seen.covered(to_mesh(carved, grid))
    for (_, mask), ends in list(zip(seen.small, left))[LEAST_ASKING - 1 :]:
        mask &= ends
    assert not carved_solids(carved, hull, np.zeros(grid.shape), [], grid, seen).any()


def test_a_part_that_ground_is_seen_through_is_a_shred_of_it(scene, ring):
    """Made masks hold it; a plane that lies lower than the ground proves nothing."""
    seen, grid, hull, carved = scene
    seen = replace(seen, ground=-0.5)
    free = np.zeros(grid.shape)
    solid = lambda height: carved_solids(
        carved, hull, free, [depth_of_plane(v, height) for v in seen.rig.views], grid, seen
    )
    assert not solid(-0.5).any() and solid(-1.5).any()


def test_depth_behind_what_is_solid_goes(scene):
    """By more than fusion forgives; the rest stays."""
    seen, grid, hull, _ = scene
    depths = [depth_of_plane(v, -1.5) for v in seen.rig.views]
    left, share = without_seen_through(depths, hull > 0, grid)
    covered = seen.covered(to_mesh(hull, grid))
    for before, after, inside in zip(depths, left, covered):
        known = before.agreeing > 0
        assert (after.agreeing[~inside & known] > 0).mean() > 0.9
        assert not after.agreeing[inside].any() and (after.depth == before.depth).all()
    assert 0 < share < 1
    near = [replace(d, depth=0.1 * d.depth) for d in depths]
    assert without_seen_through(near, hull > 0, grid)[1] == 0
    assert without_seen_through(depths, np.zeros(grid.shape, bool), grid) == (depths, 0.0)
