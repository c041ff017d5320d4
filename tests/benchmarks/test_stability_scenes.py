"""Scenes of the stability suite that are rendered: every knob's hardest one can be made, and photos
taken anew are those of the light's map where nothing is wrong."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.make_scene import Options
from benchmarks.stability import lights
from benchmarks.stability.knobs import KNOBS
from benchmarks.stability.scenes import BASE, BASES, Recipe, base_recipe, size_named
from benchmarks.suite.objects import write_thing
from pipeline.geometry.mesh_io import load_mesh

OPTIONS = Options(size=24, spp=128, views=3, test=1)
RENDERED = [name for name, knob in KNOBS.items() if knob.render is not None]


@pytest.fixture(scope="module")
def shoot(tmp_path_factory):
    """The base's object under the lamp, at an exposure that shows it."""
    asset = tmp_path_factory.mktemp("asset")
    recipe = base_recipe(BASES[BASE], size_named("XS"))
    write_thing(recipe.thing, asset, 64, recipe.seed)
    return lights.Shoot(asset, OPTIONS, 0.2 * lights.lamp_and_room(64))


def in_map(shoot, turned: float = 0.0) -> np.ndarray:
    """Photos in the light's map alone."""
    scene = lights.load_scene(shoot.asset, shoot.light, turned=turned)
    return shoot.photos(lambda position: scene)


def difference(one: np.ndarray, two: np.ndarray) -> float:
    """Of the photos, over their mean."""
    return float(np.abs(one.mean(-1) - two.mean(-1)).mean() / one.mean())


def test_distant_lamp_is_the_one_in_the_map(shoot):
    plain = in_map(shoot)
    noise = difference(plain, in_map(replace(shoot, options=replace(OPTIONS, seed=1))))
    assert noise > 0.5  # other cameras: photos that differ as much are of another scene
    far, near = (difference(plain, lights.near_lamp(shoot, x)) for x in (0.005, 0.6))
    assert far < 0.12 and near > 2 * far


def test_light_that_does_not_turn_and_photographer_without_size_change_nothing(shoot):
    plain = in_map(shoot)
    for change in (lights.turntable, lights.photographer):
        np.testing.assert_allclose(change(shoot, 0.0), plain, atol=1e-6)
    assert difference(plain, lights.turntable(shoot, 1.0)) > 0.2
    dark = lights.photographer(shoot, 50.0)
    assert lights.SHADOW * plain.mean() < dark.mean() < 0.99 * plain.mean()


def test_turning_light_turns_with_the_camera(shoot):
    """The first photo is as it was, the second in light that is turned as its camera is."""
    turned = lights.turntable(shoot, 1.0)
    np.testing.assert_allclose(turned[0], in_map(shoot)[0], atol=1e-6)
    first, second = lights.camera_positions(3, 0)[:2]
    azimuth = [np.degrees(np.arctan2(p[0], p[2])) for p in (first, second)]
    alone = in_map(shoot, turned=azimuth[1] - azimuth[0])[1]
    np.testing.assert_allclose(turned[1], alone, atol=1e-3)


@pytest.mark.parametrize("name", RENDERED)
def test_hardest_recipe_can_be_made(name, tmp_path):
    knob = KNOBS[name]
    recipe: Recipe = knob.render(base_recipe(BASES[BASE], size_named("XS")), knob.values[-1])
    write_thing(recipe.thing, tmp_path, 64, recipe.seed)
    assert len(load_mesh(tmp_path / "mesh.ply").faces) > 500
    if not isinstance(recipe.light, str):
        assert recipe.light.shape[1] == 2 * recipe.light.shape[0]
        assert np.isfinite(recipe.light).all() and recipe.light.min() >= 0
