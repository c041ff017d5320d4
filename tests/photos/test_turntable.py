"""Light that moves with the camera, told from light that rests, on spheres shaded by formula."""

import numpy as np
import pytest

from pipeline.base.errors import InputError
from pipeline.photos.focus import said_of_focus
from pipeline.photos.readings import Readings
from pipeline.photos.turntable import LightMotion, check, light_motion, off_circle
from tests.seeds import numpy_rng

RESTING = np.array([0.6, 0.5, 0.6])


def sightings(views, kind, rng, points=600):
    """xyz (n, 3) on a sphere and log2 brightness (views, n) with 10 % noise, NaN where hidden.
    kind: light that rests or moves (from the camera's left and above), matt, or glossy (a lobe of
    half the matt part's strength that follows the mirrored ray).
    """
    normal = rng.normal(size=(points, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    xyz = 0.4 * normal
    level = np.full((len(views), points), np.nan)
    for k, view in enumerate(views):
        to_camera = view.position - xyz
        to_camera /= np.linalg.norm(to_camera, axis=1, keepdims=True)
        facing = (normal * to_camera).sum(1)
        light = RESTING
        if "moves" in kind:
            light = np.array([-0.7, -0.5, -0.6]) @ view.world_to_camera[:3, :3]
        light = light / np.linalg.norm(light)

        shade = 0.3 + np.maximum(normal @ light, 0)
        if "glossy" in kind:
            half = light + to_camera
            half /= np.linalg.norm(half, axis=1, keepdims=True)
            shade = shade + 0.5 * np.maximum((normal * half).sum(1), 0) ** 20
        noise = 0.1 * rng.normal(size=points)
        level[k] = np.where(facing > 0.3, np.log2(shade) + noise, np.nan)
    return xyz, level


@pytest.mark.parametrize(
    "kind, moves",
    [("moves", True), ("moves glossy", True), ("rests", False), ("rests glossy", False)],
)
def test_moving_light_is_told_from_resting_light_and_from_gloss(ring, kind, moves):
    views = ring(16, elevation=25.0)
    xyz, level = sightings(views, kind, numpy_rng(0))
    motion = light_motion(views, Readings.of(level), xyz, np.zeros(3), 0.5)
    assert motion.moves == moves
    assert motion.explained > 0.3 if moves else motion.explained < 0.05


def test_few_points_are_no_evidence(ring):
    views = ring(16)
    xyz, level = sightings(views, "moves", numpy_rng(0), points=90)
    assert light_motion(views, Readings.of(level), xyz, np.zeros(3), 0.5).explained is None


def test_deviation_from_a_circle():
    angle = np.linspace(0, 5, 20)
    circle = 3 * np.stack([np.cos(angle), 0 * angle + 0.2, np.sin(angle)], 1) + [1, 2, 3]
    assert off_circle(circle) < 1e-6
    wobble = 0.1 * 3 * numpy_rng(0).normal(size=circle.shape) / np.sqrt(2)
    assert 0.06 < off_circle(circle + wobble) < 0.12


def test_refused_with_the_reason_or_accepted_with_a_warning():
    turntable, flash = LightMotion(0.25, 800, 0.005), LightMotion(0.25, 800, 0.2)
    with pytest.raises(InputError, match=r"fixed camera and lamp.*0.5 %.*\n.*moving_light: accept"):
        check(turntable, "scene", accept=False)
    with pytest.raises(InputError, match="flash moves with the camera"):
        check(flash, "scene", accept=False)
    (warning,) = check(turntable, "scene", accept=True)
    assert "not to be trusted" in warning
    assert check(LightMotion(0.03, 800, 0.005), "scene", accept=False) == []
    assert check(LightMotion(None, 20, 0.005), "scene", accept=False) == []


def test_blur_is_named_where_photos_are_out_of_focus():
    """It changes brightness at edges, as a lamp would that moves."""
    flash, soft = LightMotion(0.25, 800, 0.2), said_of_focus([12.0] * 9)
    with pytest.raises(
        InputError, match=r"out of focus.*12 pixels.*\n.*photograph in focus"
    ) as told:
        check(flash, "scene", False, soft)
    assert "flash" not in str(told.value)
    assert "out of focus" in check(flash, "scene", True, soft)[0]
    assert check(LightMotion(0.03, 800, 0.005), "scene", False, soft) == []
