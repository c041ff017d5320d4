"""What the bare ground looks like."""

import tracemalloc

import numpy as np
import pytest

from pipeline.geometry.cameras import Rig
from pipeline.masks import ground
from pipeline.masks.ground import TEXTURE, bare_ground
from tests.seeds import numpy_rng


@pytest.mark.slow
def test_the_bare_ground_is_the_same_in_parts_and_needs_no_stack_of_all_views(ring, monkeypatch):
    """Memory does not grow by a texture of the ground with every photo."""
    rng = numpy_rng(0)
    views = ring(24, 40)
    rig = Rig(views, np.zeros(3), 0.4, "sfm")
    labs = {v.name: rng.random((40, 40, 3)).astype(np.float32) for v in views}
    covered = {v.name: rng.random((40, 40)) < 0.2 for v in views}

    tracemalloc.start()
    in_parts = bare_ground(rig, labs, -0.3, covered)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 0.5 * len(views) * TEXTURE**2 * 3 * 4

    monkeypatch.setattr(ground, "PART", TEXTURE**2)
    whole = bare_ground(rig, labs, -0.3, covered)
    assert np.isfinite(whole[1]).mean() > 0.2
    for a, b in zip(in_parts, whole):
        np.testing.assert_array_equal(a, b)
