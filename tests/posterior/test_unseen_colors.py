"""What no photo shows: colours that join on smoothly, over the surface and not over the atlas."""

from dataclasses import replace

import numpy as np
import pytest

from pipeline.geometry.mesh_io import Mesh
from pipeline.posterior.refine import smooth_where_unseen
from pipeline.posterior.unseen_colors import over_unseen, patches
from pipeline.render.renderer import Explanation
from tests.seeds import numpy_rng

SIZE = 64
CELLS = 8
RED, BLUE = np.array([0.8, 0.1, 0.1]), np.array([0.1, 0.1, 0.8])


def sheet(points: np.ndarray, low: tuple[float, float], high: tuple[float, float]) -> Mesh:
    """A grid of CELLS squares a side, points (CELLS + 1, CELLS + 1, 3) in rows of growing v, that
    fills the box from uv `low` to `high` of the atlas.
    """
    side = CELLS + 1
    v, u = np.meshgrid(np.linspace(0, 1, side), np.linspace(0, 1, side), indexing="ij")
    uv = np.stack([u, v], -1).reshape(-1, 2) * np.subtract(high, low) + low
    k = (np.arange(CELLS)[:, None] * side + np.arange(CELLS)).ravel()
    lower, upper = np.stack([k, k + 1, k + side], 1), np.stack([k + 1, k + side + 1, k + side], 1)
    flat = points.reshape(-1, 3)
    return Mesh(flat, np.concatenate([lower, upper]), np.tile([0.0, 0, 1], (len(flat), 1)), uv)


def plane(x0: float) -> np.ndarray:
    """Points of the unit square from x0 on in the plane z = 0."""
    y, x = np.meshgrid(np.linspace(0, 1, CELLS + 1), np.linspace(0, 1, CELLS + 1), indexing="ij")
    return np.stack([x0 + x, y, np.zeros_like(x)], -1)


def joined(*meshes: Mesh) -> Mesh:
    """Meshes as the charts of one, with corners of their own."""
    first = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    faces = [mesh.faces + k for mesh, k in zip(meshes, first)]
    parts = [np.concatenate([getattr(m, n) for m in meshes]) for n in ("vertices", "normals", "uv")]
    return Mesh(parts[0], np.concatenate(faces), parts[1], parts[2])


@pytest.fixture
def square() -> Mesh:
    return sheet(plane(0), (0, 0), (1, 1))


def test_a_gap_between_two_colours_goes_over_from_one_to_the_other(square):
    """Seen at both ends, red and blue: between them it is mixed evenly, and what is seen stays."""
    image = np.zeros((SIZE, SIZE, 3))
    image[:, :16], image[:, -16:] = RED, BLUE
    shown = np.zeros((SIZE, SIZE), bool)
    shown[:, :16] = shown[:, -16:] = True
    found = over_unseen(image, shown, square)
    np.testing.assert_array_equal(found[shown], image[shown])

    # upper and lower rim are left out: there the grid's diagonals all lean to one side
    at = np.clip((np.arange(SIZE) + 0.5 - 16) / 32, 0, 1)[None, :, None]
    expected = np.broadcast_to((1 - at) * RED + at * BLUE, image.shape)
    assert np.abs(found - expected)[16:-16].max() < 0.05


def test_no_colour_is_beyond_those_that_are_seen(square):
    """Maximum principle."""
    rng = numpy_rng(3)
    image = rng.uniform(0.2, 0.7, (SIZE, SIZE, 3))
    shown = np.zeros((SIZE, SIZE), bool)
    shown[:20] = shown[40:50, 30:] = True
    found = over_unseen(np.where(shown[..., None], image, 9.0), shown, square)
    seen = image[shown]
    assert (found >= seen.min(0) - 1e-9).all() and (found <= seen.max(0) + 1e-9).all()


def test_an_unseen_chart_has_the_colours_of_its_neighbour_on_the_surface():
    """Three charts side by side in the atlas; the middle one is hidden and hangs together with the
    left one alone.
    """
    left = sheet(plane(0), (0.02, 0), (0.3, 1))
    hidden = sheet(plane(1), (0.36, 0), (0.64, 1))
    other = sheet(plane(7), (0.7, 0), (0.98, 1))
    image = np.zeros((SIZE, SIZE, 3))
    image[:, :21], image[:, 43:] = RED, BLUE
    shown = np.zeros((SIZE, SIZE), bool)
    shown[:, :21] = shown[:, 43:] = True
    found = over_unseen(image, shown, joined(left, hidden, other))
    np.testing.assert_allclose(found[:, 24:40], np.broadcast_to(RED, (SIZE, 16, 3)), atol=1e-9)


def test_a_part_that_no_photo_shows_has_the_mean_colour():
    seen = sheet(plane(0), (0.02, 0), (0.48, 1))
    hidden = sheet(plane(5), (0.52, 0), (0.98, 1))
    image = np.zeros((SIZE, SIZE, 3))
    shown = np.zeros((SIZE, SIZE), bool)
    shown[:, :30] = True
    image[:32, :30], image[32:, :30] = RED, BLUE
    found = over_unseen(image, shown, joined(seen, hidden))
    np.testing.assert_allclose(
        found[:, 36:60], np.full((SIZE, 24, 3), 0.5 * (RED + BLUE)), atol=0.03
    )


def test_a_map_without_any_seen_texel_stays(square):
    image = numpy_rng(4).uniform(size=(SIZE, SIZE, 3))
    assert over_unseen(image, np.zeros((SIZE, SIZE), bool), square) is image


def test_a_few_stray_rays_colour_nothing_but_their_texels():
    """Texels of a hidden chart that lie apart are blue: the rest has its neighbour's red."""
    left = sheet(plane(0), (0.02, 0), (0.48, 1))
    hidden = sheet(plane(1), (0.52, 0), (0.98, 1))
    image = np.zeros((SIZE, SIZE, 3))
    image[:, :30], image[30:36:2, 46:52:2] = RED, BLUE
    shown = image.any(-1)
    found = over_unseen(image, shown, joined(left, hidden))
    np.testing.assert_array_equal(found[30:36:2, 46:52:2], image[30:36:2, 46:52:2])
    inside = (np.arange(SIZE) >= 36) & (np.arange(SIZE) < 60) & ~shown
    np.testing.assert_allclose(found[inside], np.broadcast_to(RED, found[inside].shape), atol=1e-9)


@pytest.mark.parametrize("size, kept", [(SIZE, 1), (512, 12)])
def test_what_counts_as_a_patch_grows_with_the_map(size, kept):
    """Fifty texels of 1024 a side are twelve and a half of 512, and never one alone."""
    found = {}
    for count in (kept, kept + 1):
        shown = np.zeros((size, size), bool)
        shown[10, 10 : 10 + count] = True
        found[count] = patches(shown).any()
    assert found == {kept: False, kept + 1: True}


def test_what_is_hidden_between_a_metal_and_none_is_one_of_them(square):
    """Roughness goes over from one to the other, metallic does not."""
    shown = np.zeros((SIZE, SIZE), bool)
    shown[:, :16] = shown[:, -16:] = True
    metal = np.where(np.arange(SIZE) < 32, 1.0, 0.0) * np.ones((SIZE, 1))
    blank = Explanation(np.ones((2, 4, 3)), np.full((SIZE, SIZE, 3), 0.5), metal, metal)
    found = smooth_where_unseen(blank, shown, shown, square)
    assert set(np.unique(found.metallic)) == {0.0, 1.0}
    assert ((found.roughness > 0.2) & (found.roughness < 0.8)).any()
    np.testing.assert_array_equal(found.metallic[shown], metal[shown])

    half = replace(blank, metallic=np.full((SIZE, SIZE), 0.5))
    found = smooth_where_unseen(half, shown, shown, square)
    np.testing.assert_allclose(found.metallic, 0.5, atol=1e-9)
