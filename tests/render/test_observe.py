import numpy as np

from pipeline.render.observe import PLACES, by_place
from tests.seeds import numpy_rng


def test_pixels_of_one_part_of_the_surface_follow_each_other():
    """Whatever photo they are of; within a part they stay in the photos' order."""
    uv = numpy_rng(0).random((5000, 2)).astype(np.float32)
    uv[:2] = 0, 1  # the map's ends are in it
    order = by_place(uv)
    assert (np.sort(order) == np.arange(5000)).all()

    column, row = np.minimum((PLACES * uv[order]).astype(int), PLACES - 1).T
    part = row * PLACES + column
    begins = np.flatnonzero(np.diff(part)) + 1
    assert len(begins) + 1 == len(np.unique(part))
    assert all((np.diff(one) > 0).all() for one in np.split(order, begins))
