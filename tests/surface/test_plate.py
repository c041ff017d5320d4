"""The thin plate on a ball of marching cubes, whose triangles are slivers beside large ones."""

import numpy as np
import pytest
from skimage.measure import marching_cubes

from pipeline.geometry.mesh_io import unit
from pipeline.surface.plate import Plate
from tests.seeds import numpy_rng

RADIUS = 0.5


@pytest.fixture(scope="module")
def ball():
    """Vertices (n, 3) and faces, and the length of a cell."""
    axis = np.linspace(-0.6, 0.6, 48)
    field = RADIUS - np.sqrt(sum(x**2 for x in np.meshgrid(axis, axis, axis, indexing="ij")))
    vertices, faces, _, _ = marching_cubes(field, 0.0, gradient_direction="ascent")
    cell = axis[1] - axis[0]
    return vertices * cell + axis[0], faces.astype(np.int64), cell


def settled(ball, stiffness, bumps, steps=8):
    """Vertices after steps of a plate whose upper half is pulled back to the ball, as textured
    photos would, and how far each step moved a vertex at most, in footprints.
    """
    true, faces, footprint = ball
    noise = numpy_rng(3).normal(0, bumps * footprint, len(true))
    x = home = true + noise[:, None] * unit(true)
    plate = Plate(len(x), faces, stiffness, 0.5)
    seen = true[:, 1] > 0
    far = []
    for _ in range(steps):
        off = np.linalg.norm(x, axis=1) - RADIUS
        h = np.where(seen, 0.3 * plate.area(x) / footprint**4, 0.0)
        moved, _ = plate.step(x, home, -h * off, h, footprint)
        far.append(float(np.linalg.norm(moved - x, axis=1).max()) / footprint)
        x = moved
    return x, far


@pytest.mark.parametrize("stiffness", [2.0, 50.0])
def test_a_plate_comes_to_rest(ball, stiffness):
    """However stiff, and though nothing pulls at the lower half."""
    x, far = settled(ball, stiffness, bumps=0.2)
    off = np.abs(np.linalg.norm(x, axis=1) - RADIUS) / ball[2]
    assert far[-1] < 0.5 * far[0] and far[-1] < 0.2
    assert np.quantile(off, 0.99) < 0.5


def test_bumps_become_less(ball):
    true, _, footprint = ball
    x, _ = settled(ball, 2.0, bumps=0.2)
    rough = np.std(np.linalg.norm(x, axis=1) - RADIUS) / footprint
    assert rough < 0.1  # of 0.2
