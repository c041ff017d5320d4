"""What of a map is surface, and what of that photos show."""

import numpy as np
import pytest

from pipeline.base.errors import InputError
from pipeline.geometry.mesh_io import Mesh
from pipeline.render.surface_texels import SurfaceTexels

# a triangle that covers the map's lower left half
CORNERS = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
HALF = Mesh(np.eye(3), np.array([[0, 1, 2]]), np.eye(3), CORNERS)
SIZE = 32


def texels() -> SurfaceTexels:
    """The left half of the map is shown."""
    return SurfaceTexels.of(HALF, np.arange(SIZE) < np.full((SIZE, 1), SIZE // 2))


def test_only_surface_counts_and_only_what_is_shown_is_seen():
    found = texels()
    assert found.surface[-1, 0] and not found.surface[0, -1]
    assert found.surface.mean() == pytest.approx(0.5, abs=0.03)
    assert found.seen[-1, 0] and not found.seen[-1, -2] and found.surface[-1, -2]
    assert found.unseen_share == pytest.approx(0.25, abs=0.03)  # a triangle of half the side


def test_it_is_read_as_it_was_written_and_at_other_sizes(tmp_path):
    found = texels()
    found.save(tmp_path)
    again = SurfaceTexels.load(tmp_path)
    assert (again.surface == found.surface).all() and (again.seen == found.seen).all()
    for size in (SIZE // 2, 2 * SIZE):
        other = found.resized(size)
        assert other.seen.shape == (size, size) and not (other.seen & ~other.surface).any()
        assert other.unseen_share == pytest.approx(found.unseen_share, abs=0.05)


def test_a_sample_of_an_earlier_version_is_refused(tmp_path):
    with pytest.raises(InputError, match="refine it anew"):
        SurfaceTexels.load(tmp_path)
