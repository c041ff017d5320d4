"""Figures of an atlas, on maps whose stretch is known."""

import numpy as np
import pytest

from benchmarks.atlas import stretch
from benchmarks.atlas_tables import table
from pipeline.geometry.mesh_io import Mesh

SQUARE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0.0]])
HALVES = np.array([[0, 1, 2], [0, 2, 3]])


def test_stretch_of_a_turned_and_of_a_squeezed_square():
    turn = np.array([[0.6, -0.8, 0], [0, 0, 1], [0.8, 0.6, 0]])
    turned = Mesh(SQUARE @ turn, HALVES, SQUARE, 0.3 * SQUARE[:, [1, 0]] + 0.1)
    assert stretch(turned) == pytest.approx({"angle_stretch": 1, "area_stretch": 0}, abs=1e-9)
    squeezed = Mesh(SQUARE, HALVES, SQUARE, SQUARE[:, :2] * [0.8, 0.2])
    assert stretch(squeezed) == pytest.approx({"angle_stretch": 4, "area_stretch": 0}, abs=1e-9)


def test_areas_count_in_doublings_over_the_whole_page():
    """Of two equal squares one gets 7 times the texels of the other: 7/4 and 1/4 of the mean."""
    uv = np.concatenate([7**0.5 * 0.1 * SQUARE[:, :2], 0.1 * SQUARE[:, :2] + 0.5])
    both = Mesh(
        np.concatenate([SQUARE, SQUARE + 2]), np.concatenate([HALVES, HALVES + 4]), None, uv
    )
    expected = (np.log2(7 / 4) + 2) / 2
    assert stretch(both)["area_stretch"] == pytest.approx(expected)


def test_table_tells_none_from_little():
    row = {"mesh": "m", "faces": 2000, "route": "r", "charts": 3, "utilisation": 0.5}
    row |= {"overlap": 0.0, "mirrored": 2e-5, "angle_stretch": 1.2, "area_stretch": 0.3}
    text = table([row | {"seconds": 12.3}, {"mesh": "m", "faces": 1, "route": "s", "failed": "no"}])
    assert "| 3 | .50 | 0 | 0.002 | 1.20 | .30 | 12 |" in text and "| s | no |" in text
