"""A surface made anew goes through what is known of it, and evens what is not."""

import numpy as np
import pytest

from pipeline.geometry.mesh_io import Mesh
from pipeline.geometry.voxels import Grid
from pipeline.surface.clean import facts, signed_volume, to_mesh
from pipeline.surface.screened_poisson import FULLY_EACH, rebuilt
from pipeline.surface.silhouettes import SLAB, silhouettes_of
from pipeline.surface.solids import contour
from tests.seeds import numpy_rng
from tests.surface.test_solids import vase_and_coin
from tests.surface.test_surface import sphere

# the fixtures: a rig around a sphere, and its masks; a vase, a coin and a chip, and theirs
sphere, vase_and_coin = sphere, vase_and_coin

RADIUS = 0.35
GRID = Grid.over(-0.5 * np.ones(3), 0.5 * np.ones(3), 48)
MAPS = 12
KNOWN = np.full(GRID.shape, FULLY_EACH * MAPS)
NO_HULL = np.ones(GRID.shape)  # its surface is nowhere near


def ball(dents: np.ndarray | float = 0.0) -> Mesh:
    """A ball about the origin; dents: of the radius, at every cell."""
    away = np.linalg.norm(GRID.centers(), axis=1).reshape(GRID.shape)
    return to_mesh((RADIUS - dents - away) / (4 * GRID.cell), GRID)


def cap() -> np.ndarray:
    """Cells, bool, about an end of the ball, a seventh of its surface."""
    return (GRID.centers()[:, 0] > 0.7 * RADIUS).reshape(GRID.shape)


def off(mesh: Mesh, beyond: float = -1.0) -> float:
    """Root mean square, in cells, of vertices' distances from the true ball, where x is more than
    `beyond` radii.
    """
    vertices = mesh.vertices[mesh.vertices[:, 0] > beyond * RADIUS]
    away = np.linalg.norm(vertices, axis=1) - RADIUS
    return float(np.sqrt((away**2).mean())) / GRID.cell


def test_what_is_known_stays_where_it_is():
    made, found = rebuilt(ball(), KNOWN, NO_HULL, GRID, MAPS)
    assert found == {"left_out": 0.0, "parts": [1, 1]} and off(made) < 0.2
    assert facts(made)["watertight"] and facts(made)["parts"] == 1
    assert signed_volume(made.vertices, made.faces) > 0


@pytest.fixture(scope="module")
def rags():
    """A ball whose cap is torn by up to three cells at random."""
    torn = 3 * GRID.cell * numpy_rng(0).integers(0, 2, GRID.shape)
    return ball(np.where(cap(), torn, 0.0))


def bend(mesh: Mesh) -> float:
    """Median angle in degrees of faces' normals and the ball's, on the cap."""
    corners = mesh.vertices[mesh.faces]
    at = corners.mean(1)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    cosine = (normal * at).sum(1) / np.linalg.norm(normal, axis=1) / np.linalg.norm(at, axis=1)
    return float(np.degrees(np.median(np.arccos(np.clip(cosine[at[:, 0] > 0.8 * RADIUS], -1, 1)))))


def test_rags_are_drawn_over_where_depth_maps_hardly_agree(rags):
    """And there alone: what masks stand for, on the hull, is known without depth."""
    little = np.where(cap(), 0.0, KNOWN)
    made, found = rebuilt(rags, little, NO_HULL, GRID, MAPS)
    kept, all_known = rebuilt(rags, little, np.where(cap(), 0.0, 1.0), GRID, MAPS)
    assert found["left_out"] > 0.03 > all_known["left_out"]
    assert bend(made) < 0.8 * bend(kept) and facts(made)["watertight"]


def test_a_part_of_which_nothing_is_known_is_not_cut_off(rags):
    """Its points are too far from what is known to do without."""
    half = (GRID.centers()[:, 0] > -0.5 * RADIUS).reshape(GRID.shape)
    made, _ = rebuilt(ball(), np.where(half, 0.0, KNOWN), NO_HULL, GRID, MAPS)
    assert made.vertices[:, 0].max() > RADIUS - 2 * GRID.cell


def test_another_surface_stands_in_for_what_is_not_earned():
    """The cap is carved off by three cells, although depth maps agree on it."""
    carved = ball(np.where(cap(), 3 * GRID.cell, 0.0))
    earned = carved.vertices[:, 0] < 0.6 * RADIUS
    as_it_is, _ = rebuilt(carved, KNOWN, NO_HULL, GRID, MAPS)
    made, found = rebuilt(carved, KNOWN, NO_HULL, GRID, MAPS, None, earned, ball())
    assert off(as_it_is, 0.8) > 2 and off(made, 0.8) < 0.3 and off(made) < 0.5
    assert found["left_out"] == pytest.approx(1 - earned.mean()) and facts(made)["watertight"]


def test_of_next_to_nothing_the_surface_is_left_as_it_is():
    cell = np.full(GRID.shape, -0.5)
    cell[24, 24, 24] = 0.5
    surface = contour(cell, GRID)
    made, found = rebuilt(surface, np.zeros(GRID.shape), NO_HULL, GRID, MAPS)
    assert facts(made)["watertight"] and (found["parts"][0] == 0) == (made is surface)


def test_of_its_parts_those_are_kept_that_masks_ask_for(vase_and_coin):
    """The vase and the coin beside it, not the chip, which masks show too."""
    grid, field, seen = vase_and_coin
    many = np.full(grid.shape, FULLY_EACH * MAPS)
    made = lambda covered: rebuilt(
        contour(field, grid), many, np.ones(grid.shape), grid, MAPS, covered
    )
    asked, unasked = made(seen.covered), made(None)
    assert asked[1]["parts"] == [2, 3] and unasked[1]["parts"] == [1, 3]
    assert asked[0].vertices[:, 0].max() == pytest.approx(0.6, abs=grid.cell)
    assert unasked[0].vertices[:, 0].max() < 0.4


def test_nothing_reaches_below_the_ground(sphere):
    rig, masks = sphere
    rig.facts["plane"] = {"offset": -0.2}
    seen = silhouettes_of(rig, masks, set(masks), given=False)
    end = -0.2 + SLAB * GRID.cell
    low = seen.raised(GRID, ball()).vertices[:, 1]
    assert low.min() == pytest.approx(end) and (low > end).mean() > 0.5
