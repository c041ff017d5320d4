"""Of a field's small solids those stay that masks ask for."""

from dataclasses import replace

import numpy as np
import pytest

from pipeline.geometry.cameras import Rig
from pipeline.geometry.mesh_io import Mesh
from pipeline.geometry.voxels import Grid
from pipeline.surface.clean import facts, zero_surface
from pipeline.surface.preview import Silhouette
from pipeline.surface.silhouettes import silhouettes_of
from pipeline.surface.solids import contour, whole_solids


def box(low: int, high: int) -> tuple[slice, slice, slice]:
    return (slice(low, high),) * 3


def test_small_solids_and_hidden_cavities_go():
    field = -np.ones((20, 20, 20), np.float32)
    field[box(4, 16)] = 1
    field[box(9, 11)] = -1
    field[box(0, 2)] = 1
    clean = whole_solids(field, Grid(np.zeros(3), 1.0, field.shape))
    assert (clean[box(9, 11)] > 0).all() and (clean[box(0, 2)] < 0).all()


def ball(grid: Grid, centre: list[float], radius: float) -> np.ndarray:
    """A field (nx, ny, nz) that is positive in a ball."""
    away = np.linalg.norm(grid.centers() - centre, axis=1)
    return ((radius - away) / grid.cell).reshape(grid.shape)


@pytest.fixture
def vase_and_coin(ring):
    """The field of a large ball and of one of a hundredth of its volume that stands apart, and of
    a chip of a thousandth, and what the masks say in which photos show them all.
    """
    grid = Grid.over(np.full(3, -0.7), np.full(3, 0.7), 56)
    both = np.maximum(ball(grid, [-0.1, 0, 0], 0.42), ball(grid, [0.5, -0.3, 0.1], 0.1))
    both = np.maximum(both, ball(grid, [0.5, 0.3, 0.1], 0.042))
    views = ring(14, 96)
    shown = Silhouette(contour(both, grid))
    masks = {view.name: shown(view) for view in views}
    rig = Rig(views, np.zeros(3), 0.8, "transforms.json")
    return grid, both, silhouettes_of(rig, masks, set(masks), True)


def parts(mesh: Mesh | None) -> int:
    assert mesh is not None
    return facts(mesh)["parts"]


def test_a_small_thing_that_stands_apart_is_kept(vase_and_coin):
    grid, both, seen = vase_and_coin
    assert parts(zero_surface(both, grid)) == 1  # without masks nothing asks for it
    assert parts(zero_surface(both, grid, seen.covered)) == 2


def test_a_phantom_before_the_object_is_not(vase_and_coin):
    """It lies above the object, where the photos, taken from about its height, see it over the
    object or beside every mask.
    """
    grid, both, seen = vase_and_coin
    phantom = ball(grid, [-0.1, 0.6, 0], 0.09)
    mesh = zero_surface(np.maximum(both, phantom), grid, seen.covered)
    assert parts(mesh) == 2 and mesh.vertices[:, 1].max() < 0.5


def test_nothing_is_asked_about_of_masks_that_show_the_large_thing_alone(vase_and_coin):
    grid, both, seen = vase_and_coin
    shown = Silhouette(contour(ball(grid, [-0.1, 0, 0], 0.42), grid))
    alone = replace(seen, masks={view.name: shown(view) for view in seen.rig.views})
    assert parts(zero_surface(both, grid, alone.covered)) == 1
