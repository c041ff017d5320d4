import numpy as np
import pytest

from pipeline.geometry.cameras import Rig
from pipeline.geometry.voxels import Grid
from pipeline.masks.agreement import hull_points
from pipeline.masks.colours import Colours
from pipeline.masks.volume import connected, nearest_depth, soft_hull, the_object
from tests.seeds import numpy_rng
from tests.surface.test_surface import silhouettes

CELL = 0.05


def block(low, high):
    """Cell centres of a box."""
    grid = Grid.over(np.array(low, float), np.array(high, float), 1)
    shape = np.round((np.array(high) - low) / CELL).astype(int)
    return Grid(grid.low, CELL, tuple(shape)).centers()


@pytest.fixture
def rig(ring):
    return Rig(ring(12, 96), np.zeros(3), 1.0, "transforms.json")


def test_the_object_is_where_the_axes_meet_however_large_its_neighbour_is(rig):
    small = block([-0.2, -0.2, -0.2], [0.2, 0.2, 0.2])
    large = block([0.5, -0.3, -0.3], [1.1, 0.3, 0.3])
    found = the_object(rig, np.concatenate([large, small]), CELL, "one")
    assert len(found.points) == len(small) and np.abs(found.points).max() < 0.2
    assert [len(o) for o in found.others] == [len(large)]
    assert len(the_object(rig, np.concatenate([large, small]), CELL, "all").points) == (
        len(small) + len(large)
    )


def test_gaps_of_two_cells_do_not_separate_three_do():
    left = block([0, 0, 0], [0.2, 0.2, 0.2])
    beside = lambda cells: left + [0.2 + cells * CELL, 0, 0]
    assert len(connected(np.concatenate([left, beside(2)]), CELL)) == 1
    assert len(connected(np.concatenate([left, beside(3)]), CELL)) == 2


def test_specks_are_not_other_things(rig):
    body = block([-0.2, -0.2, -0.2], [0.2, 0.2, 0.2])
    speck = block([0.8, 0, 0], [0.9, 0.1, 0.1])
    assert the_object(rig, np.concatenate([body, speck]), CELL, "one").others == []


def test_a_given_mask_takes_volume_away(rig):
    masks = silhouettes(rig.views, 0.4)
    name = rig.views[0].name
    half = masks[name] & (np.arange(96) < 48)
    odds = {n: np.where(m, 3, -3).astype(np.float32) for n, m in masks.items()}
    odds[name] = np.where(half, 8, -8).astype(np.float32)
    points = soft_hull(rig, odds, -np.inf, {name: half}, "one", 32).points
    right = points @ rig.views[0].world_to_camera[0, :3]
    assert right.max() < 0.1 and right.min() < -0.3


def test_a_given_mask_adds_the_volume_that_it_asks_for(rig):
    masks = silhouettes(rig.views, 0.4)
    name = rig.views[0].name
    axis = rig.views[0].world_to_camera[0, :3]
    odds = {}
    for v in rig.views:  # what lies on one side of the ball looks like its surroundings
        o, d = v.rays(np.stack(np.meshgrid(np.arange(96) + 0.5, np.arange(96) + 0.5), -1))
        middle = o - (o * d).sum(-1, keepdims=True) * d
        odds[v.name] = np.where(masks[v.name] & (middle @ axis < 0), 3, -1).astype(np.float32)
    reach = lambda odds, given: (
        soft_hull(rig, odds, -np.inf, given, "one", 32).points @ axis
    ).max()

    hard = np.where(masks[name], 8, -8).astype(np.float32)
    assert reach(odds, {}) < 0.15
    assert reach(odds | {name: hard}, {name: masks[name]}) > 0.3


def test_hull_stays_inside_a_given_mask(rig):
    masks = silhouettes(rig.views, 0.4)
    name = rig.views[0].name
    masks[name] = masks[name] & (np.arange(96) < 48)
    right = rig.views[0].world_to_camera[0, :3]
    voted, _ = hull_points(rig, masks)
    held, _ = hull_points(rig, masks, given=[name])
    assert (voted @ right).max() > 0.3 and (held @ right).max() < 0.05


def test_nearest_depth_is_the_front_of_a_block(rig):
    view = rig.views[1]
    depth = nearest_depth(view, block([-0.2, -0.2, -0.2], [0.2, 0.2, 0.2]), CELL, (96, 96))
    assert 2.6 < depth[48, 48] < 2.9 and np.isinf(depth[0, 0])


def test_colours_speak_for_the_side_that_shows_them():
    rng = numpy_rng(0)
    lab = np.concatenate(
        [rng.normal([60, 50, 30], 3, (40, 80, 3)), rng.normal([60, 0, 0], 3, (40, 80, 3))]
    ).astype(np.float32)
    red = np.zeros((80, 80), bool)
    red[:40] = True
    model = Colours({"a": lab}, {"a": red}, {"a": ~red}, 2.0)
    odds = model.odds(lab)
    assert odds[red].mean() > 1.8 and odds[~red].mean() < -1.8
    assert model.odds(np.array([[[20.0, -60, -60]]], np.float32)) == pytest.approx(0)
    assert not Colours({"a": lab}, {"a": red & False}, {"a": ~red}, 2.0).known
