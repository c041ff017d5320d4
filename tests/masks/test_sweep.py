import numpy as np

from pipeline.masks.cut import grow
from pipeline.masks.ground import sphere_region, to_lab, working_size
from pipeline.masks.sweep import ground_or_above, neighbours
from tests.masks.conftest import GROUND, PAINTS

BALL = ((0, 0, 0), 0.45, PAINTS["warm"])


def labs_of(folder, rig, k):
    views = [rig.views[j] for j in [k, *neighbours(rig, k)]]
    return {v.name: to_lab(folder / v.image, working_size(v)) for v in views}


def test_ground_and_what_stands_on_it_are_told_apart(make_table):
    folder, rig, (ball,) = make_table([BALL])
    k = 9  # from above
    odds = ground_or_above(rig, k, labs_of(folder, rig, k), GROUND)
    mask = ball[rig.views[k].name]
    ring = np.abs(odds) > 0
    assert (odds[mask] > 0.5).mean() > 0.9
    assert (odds[ring & ~mask] < -0.5).mean() > 0.8


def test_blank_ground_says_nothing(make_table):
    folder, rig, (ball,) = make_table([BALL], blank=True)
    odds = ground_or_above(rig, 9, labs_of(folder, rig, 9), GROUND)
    far = ~ball[rig.views[9].name]
    assert np.median(np.abs(odds[far])) < 0.5


def test_blank_ground_that_is_brighter_in_one_photo_is_not_taken_for_the_object(make_table):
    folder, rig, (ball,) = make_table([BALL], blank=True)
    name = rig.views[9].name
    labs = labs_of(folder, rig, 9)
    labs[name] = labs[name] + np.array([22, 0, 0], np.float32)
    odds = ground_or_above(rig, 9, labs, GROUND)
    bare = sphere_region(rig.views[9], rig, ball[name].shape[::-1]) & ~grow(ball[name], 4)
    assert (odds[bare] > 1).mean() < 0.1
    assert (odds[ball[name]] > 0.5).mean() > 0.9


def test_a_view_without_neighbours_says_nothing(make_table):
    folder, rig, _ = make_table([BALL])
    rig.views[:] = rig.views[:1]
    assert not ground_or_above(rig, 0, labs_of(folder, rig, 0), GROUND).any()


def test_neighbours_look_from_near_but_not_the_same_place(ring):
    from pipeline.geometry.cameras import Rig

    rig = Rig(ring(40, 32, elevation=0), np.zeros(3), 1.0, "sfm")
    assert sorted(neighbours(rig, 10)) == [7, 8, 12, 13]
