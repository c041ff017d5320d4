"""Exposure, white balance and light that moves with the camera, seen on the surface: on spheres
shaded by formula."""

import numpy as np
import pytest

from pipeline.base.config import Poses
from pipeline.base.errors import InputError
from pipeline.geometry.cameras import Rig
from pipeline.photos.photometry import gains
from pipeline.render.surface_photometry import (
    cell_brightness,
    surface_motion,
    surface_photometry,
    variance_left,
    worth_dividing,
)
from tests.photos.test_turntable import sightings
from tests.seeds import numpy_rng


def table_of(views, kind, points=6000) -> dict[str, np.ndarray]:
    """Observations of a sphere by `sightings`, with texture coordinates by longitude and height."""
    xyz, level = sightings(views, kind, numpy_rng(0), points)
    view, point = np.nonzero(np.isfinite(level))
    normal = xyz[point] / 0.4
    longitude = np.arctan2(normal[:, 0], normal[:, 2]) / (2 * np.pi) + 0.5
    to_camera = np.stack([v.position for v in views])[view] - xyz[point]
    to_camera /= np.linalg.norm(to_camera, axis=1, keepdims=True)
    rgb = np.repeat(2.0 ** level[view, point][:, None] / 4, 3, 1)
    return {
        "view": view,
        "uv": np.stack([longitude, 0.5 * normal[:, 1] + 0.5], 1),
        "rgb": rgb,
        "clipped": np.zeros(rgb.shape, bool),
        "cosine": (normal * to_camera).sum(1),
    }


@pytest.fixture
def views(ring):
    return ring(16, elevation=25.0)


def motion_in(table, views):
    brightness = cell_brightness(table, len(views))
    return surface_motion(brightness, gains(brightness), views, np.zeros(3))


@pytest.mark.parametrize(
    "kind, moves",
    [("moves", True), ("moves glossy", True), ("rests", False), ("rests glossy", False)],
)
def test_moving_light_is_told_from_resting_light_and_from_gloss(views, kind, moves):
    motion = motion_in(table_of(views, kind), views)
    assert motion.moves == moves
    assert motion.course > 0.3 if moves else motion.course < 0.1


def test_exposure_is_not_taken_for_moving_light(views):
    """Photos that get brighter along the camera's path change every point by the same course."""
    table = table_of(views, "rests")
    before = motion_in(table, views)
    table["rgb"] = table["rgb"] * 2 ** np.sin(2 * np.pi * np.arange(16) / 16)[table["view"], None]
    after = motion_in(table, views)
    assert not after.moves
    assert after.course == pytest.approx(before.course, abs=0.02)


def test_weak_course_is_no_evidence(views):
    """On a dull ball in even light a course of hundredths of a stop may explain all there is."""
    table = table_of(views, "moves")
    table["rgb"] = table["rgb"] ** 0.1
    motion = motion_in(table, views)
    assert motion.explained > 0.3 and not motion.moves


def test_cells_are_means_of_what_can_be_used():
    uv = np.array([[0.01, 0.01]] * 5 + [[0.99, 0.99]])
    rgb = np.array([0.25, 0.5, 0.9, 0.005, 0.7, 0.125])[:, None].repeat(3, 1)
    clipped = np.zeros((6, 3), bool)
    clipped[1, 0] = clipped[2] = True
    cosine = np.array([1, 1, 1, 1, 0.1, 1])
    view = np.array([0, 0, 0, 0, 0, 1])
    table = {"uv": uv, "rgb": rgb, "clipped": clipped, "cosine": cosine, "view": view}
    found = cell_brightness(table, 3)
    nan = np.nan
    np.testing.assert_allclose(found[..., 0], [[-2, nan], [nan, -3], [nan, nan]])
    np.testing.assert_allclose(found[..., 1], [[-1.5, nan], [nan, -3], [nan, nan]])


def test_jitter_is_found_and_divided_out(views):
    """Gains of photos, far from those that shading makes, come back to a few hundredths."""
    rng = numpy_rng(1)
    table = table_of(views, "rests glossy")
    # four stops from end to end: of a photo far darker than that no pixel would be left to compare
    jitter = rng.uniform(-1.5, 1.5, (16, 1)) + rng.uniform(-0.5, 0.5, (16, 3))
    jitter -= jitter.mean(0)
    table["rgb"] = table["rgb"] * 2 ** jitter[table["view"]]
    rig = Rig(views, np.zeros(3), 0.5, "transforms.json")
    stops, facts = surface_photometry(table, views, rig, "poses", Poses())
    assert facts["exposure_matched"] and facts["white_balance_matched"]
    assert np.abs(stops - jitter).max() < 0.15
    kept, facts = surface_photometry(table, views, rig, "poses", Poses(match_exposure=False))
    assert not kept.any() and "exposure_matched" not in facts


def test_shading_is_not_divided_out(views):
    rig = Rig(views, np.zeros(3), 0.5, "transforms.json")
    stops, facts = surface_photometry(table_of(views, "rests"), views, rig, "poses", Poses())
    assert not stops.any() and not facts["exposure_matched"]


@pytest.mark.parametrize("jitter, matched", [(0.0, False), (1.0, True)])
def test_a_metal_is_not_divided_by_what_it_mirrors(jitter, matched):
    """Every photo shows another part of the light in a smooth metal: its cells vary by .45 stops
    each, and by .4 together.
    """
    rng = numpy_rng(4)
    together = rng.normal(size=16)
    together = (0.4 + jitter) * (together - together.mean()) / together.std()
    apart = rng.normal(size=(16, 400))
    apart = 0.45 * (apart - apart.mean(0)) / apart.std(0)
    brightness = np.repeat((together[:, None] + apart)[..., None], 3, 2)
    fit = np.ones(16, bool)
    stops, facts = worth_dividing(brightness, gains(brightness, fit), fit)
    assert facts["exposure_matched"] is matched and bool(stops.any()) is matched


def test_variance_left_is_what_gains_do_not_explain():
    stops = np.array([[-1.0], [0.0], [1.0]])
    level = np.array([[0.0, 5.0], [1.0, 6.0], [2.0, np.nan]])[..., None]
    assert variance_left(level, stops) == pytest.approx(0)
    assert variance_left(level, 0 * stops) == 1
    half = variance_left(level, 0.5 * stops)
    assert half == pytest.approx(0.25)
    alone = np.array([[1.0, np.nan], [np.nan, 2.0], [np.nan, np.nan]])[..., None]
    assert variance_left(alone, stops) == 1  # no cell is seen twice


def test_moving_light_is_refused_or_accepted_with_a_warning(views):
    table = table_of(views, "moves")
    rig = Rig(views, np.zeros(3), 0.5, "transforms.json")
    with pytest.raises(InputError, match=r"lamp or flash|fixed camera and lamp"):
        surface_photometry(table, views, rig, "poses", Poses())
    accept = Poses(moving_light="accept")
    facts = surface_photometry(table, views, rig, "poses", accept)[1]
    assert "stops; static light: below" in facts["warnings"][0]
    assert facts["light_motion"]["moves_with_camera"]
    rig.facts["out_of_focus"] = ["soft"]
    with pytest.raises(InputError, match="soft, and brightness changes as if"):
        surface_photometry(table, views, rig, "poses", Poses())
    few = {key: values[table["view"] < 7] for key, values in table.items()}
    assert surface_photometry(few, views[:7], rig, "poses", Poses())[1]["warnings"] == []
