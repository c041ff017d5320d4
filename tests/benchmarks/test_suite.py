"""The procedural suite: closed shapes with an atlas; maps and lights follow from their names."""

import ast
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import cv2
import numpy as np
import pytest

import benchmarks.suite
from benchmarks.make_scene import Options, make_scene
from benchmarks.suite import make
from benchmarks.suite.lights import KINDS, SKIES, cie_sky, make_light, sun_disc
from benchmarks.suite.make import INDOOR, RELIGHTS, SUITES, make_suite, relights_of
from benchmarks.suite.objects import OBJECTS, textures, write_object
from benchmarks.suite.patches import assembled, texel_points, welded
from benchmarks.suite.raycast import Box, Glow, World
from pipeline.base import manifest
from pipeline.base.errors import InputError
from pipeline.base.images import read_exr, read_png, write_exr
from pipeline.geometry.mesh_io import load_mesh
from pipeline.posterior.textures import gather
from pipeline.render.envmap import directions, solid_angles
from pipeline.surface.atlas import judge


@pytest.mark.parametrize("name", OBJECTS)
def test_shapes_are_closed_and_have_an_atlas(name):
    mesh = assembled(OBJECTS[name].patches())
    found = judge(mesh.uv, mesh.faces, 512)
    assert found["in_range"] and found["overlap"] < 0.005
    assert np.linalg.norm(mesh.vertices, axis=1).max() < 1.2

    corners = welded(mesh.vertices)[mesh.faces]
    edges = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]])
    ahead, back = (np.sort(edges[:, a] * len(mesh.vertices) + edges[:, 1 - a]) for a in (0, 1))
    assert (np.diff(ahead) > 0).all()  # no edge twice in one direction
    assert (ahead == back).all()  # each has its face on the other side

    first, second, third = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    across = np.cross(second - first, third - first)
    assert (first * across).sum() > 0  # the faces look outward
    outward = (across * mesh.normals[mesh.faces[:, 0]]).sum(1) > 0
    assert outward.mean() > 0.99


def test_texels_lie_on_the_surface_that_shows_them():
    """A point's texture coordinates lead back to the point, by the map of texels' positions."""
    patches = OBJECTS["bowl"].patches()
    mesh = assembled(patches)
    size = 128
    across = 2
    atlas = np.zeros((size * across, size * across, 3))
    for k, patch in enumerate(patches):
        row, column = across - 1 - k // across, k % across
        here = np.s_[row * size : (row + 1) * size, column * size : (column + 1) * size]
        atlas[here] = texel_points(patch, size)
    back = gather(atlas, mesh.uv)
    assert np.median(np.linalg.norm(back - mesh.vertices, axis=1)) < 2e-3
    assert np.linalg.norm(back - mesh.vertices, axis=1).max() < 0.05


def test_maps_are_materials():
    for number, thing in enumerate(OBJECTS.values()):
        color, roughness, metallic = textures(thing.patches(), thing.materials, 128, number)
        assert 0.02 <= color.min() and color.max() <= 0.95
        assert 0.08 <= roughness.min() and roughness.max() <= 1
        assert set(np.unique(metallic)) <= {0.0, 1.0}  # nothing real is half metal
    kinds = {thing.kind for thing in OBJECTS.values()}
    assert kinds == {"diffuse", "glossy", "metal", "mixed", "concave"} and len(OBJECTS) == 8


@pytest.mark.slow
def test_scenes_are_made_again_bit_for_bit(tmp_path, one_thread):
    options = Options(size=24, spp=4, views=2, test=1)
    for run in ("one", "two"):
        write_object("vase", tmp_path / run / "asset", 64)
        for name in ("room_0", "sunny_1"):
            write_exr(tmp_path / run / f"{name}.exr", make_light(name, 16))
        light, other = (tmp_path / run / f"{name}.exr" for name in ("room_0", "sunny_1"))
        make_scene(tmp_path / run / "asset", light, [other], options, tmp_path / run / "scene")

    files = sorted(p.relative_to(tmp_path / "one") for p in (tmp_path / "one").rglob("*.*"))
    files.remove(Path("scene") / manifest.NAME)  # holds times
    assert len(files) > 20
    read = lambda path: read_exr(path) if path.suffix == ".exr" else path.read_bytes()
    for file in files:  # an EXR's header may hold a date; pixels are what counts
        assert np.array_equal(read(tmp_path / "one" / file), read(tmp_path / "two" / file)), file


def test_true_maps_are_the_assets(tmp_path):
    """Roughness of an object of two values lies between them, and is one of them inside."""
    write_object("vase", tmp_path / "asset", 128)
    write_exr(tmp_path / "even.exr", np.ones((8, 16, 3), np.float32))
    options = Options(size=48, spp=2, views=2, test=1)
    make_scene(tmp_path / "asset", tmp_path / "even.exr", [], options, tmp_path / "scene")

    texture = read_png(tmp_path / "asset" / "roughness.png") / 255
    shown = read_exr(tmp_path / "scene" / "truth" / "roughness" / "test_000.exr")
    shown = shown.reshape(48, 48, -1)[..., 0]
    inside = read_png(tmp_path / "scene" / "masks" / "test_000.png") > 127
    rim = cv2.dilate(inside.astype(np.uint8), np.ones((3, 3))) > 0  # a pixel that one ray met
    assert (shown[~rim] == 0).all() and (shown[inside] > 0).mean() > 0.95
    low, high = texture.min() - 1e-6, texture.max() + 1e-6
    assert ((shown == 0) | ((shown >= low) & (shown <= high))).all()
    assert load_mesh(tmp_path / "scene" / "mesh.ply").uv is not None


@pytest.mark.parametrize("kind", KINDS)
def test_lights_follow_from_their_names(kind):
    light = make_light(f"{kind}_3", 16)
    assert np.array_equal(light, make_light(f"{kind}_3", 16))
    assert not np.allclose(light, make_light(f"{kind}_4", 16), rtol=0.1)
    assert light.shape == (16, 32, 3) and light.min() >= 0 and np.isfinite(light).all()
    weight = solid_angles(16, 32)[..., None] / (12 * np.pi)
    assert (light * weight).sum() == pytest.approx(1, abs=1e-5)
    with pytest.raises(InputError, match="no light"):
        make_light(f"{kind}_x")


def test_a_sunny_light_keeps_its_flux_at_any_size():
    sun = np.array([0.6, 0.64, 0.48])
    for h in (16, 64):
        disc = sun_disc(sun, np.array([3.0, 2.0, 1.0]), h)
        flux = (disc * solid_angles(h, 2 * h)[..., None]).sum((0, 1))
        np.testing.assert_allclose(flux, [3, 2, 1], rtol=1e-4)
        assert directions(h, 2 * h).reshape(-1, 3)[disc.sum(-1).argmax()] @ sun > np.cos(2 / h)


def test_standard_sky_is_one_at_the_zenith_and_brightest_at_the_sun():
    zenith = np.array([[0.0, 1.0, 0.0]])
    sun = np.array([0.6, 0.8, 0.0])
    around = directions(90, 180).reshape(-1, 3)
    above = around[around[:, 1] > 0.3]
    for kind in SKIES:
        assert cie_sky(kind, sun, zenith)[0] == pytest.approx(1)
    for kind in (12, 13):
        assert above[cie_sky(kind, sun, above).argmax()] @ sun > 0.99
    overcast = cie_sky(1, sun, np.array([[1.0, 1e-9, 0.0]]))[0]
    assert overcast == pytest.approx(1 / (1 + 4 * np.exp(-0.7)), rel=1e-6)


def test_a_white_room_lit_by_a_small_lamp_shows_the_closed_form():
    """Radiance of a Lambertian ceiling below which a small square glows towards it: albedo / pi
    times L A cos cos / r^2."""
    glow = Glow(
        np.array([-0.005, -1.0, 0.005]),
        np.array([0.01, 0, 0]),
        np.array([0, 0, -0.01]),
        lambda d, s, t: np.full((len(d), 3), 1000.0),
    )
    assert glow.normal @ [0, 1, 0] == pytest.approx(1)
    room = Box(np.array([-4.0, -2, -4]), np.array([4.0, 2, 4]), lambda p: 0 * p + 0.5, inside=True)
    world = World([room], [glow])
    d = np.array([[0.0, 1.0, 0.0], [0.6, 0.8, 0.0]])
    points = d * (2 / d[:, 1:2])
    to = points - [0, -1, 0]
    squared = (to**2).sum(1)
    expected = 0.5 / np.pi * 1000 * 1e-4 * to[:, 1] ** 2 / squared / squared
    np.testing.assert_allclose(world.seen(d)[:, 1], expected, rtol=1e-3)


def test_suite_lights_are_no_training_lights():
    """No file of the suite imports what makes training's lights, and relights are no scene's."""
    for file in Path(benchmarks.suite.__file__).parent.glob("*.py"):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            name = getattr(node, "module", None) or ""
            assert "training" not in name, file
    for suite in SUITES.values():
        lit = [light for _, light in suite.pairs]
        assert len(set(lit)) == len(lit)
        for light in lit:
            others = relights_of(light)
            assert not set(others) & set(lit)
            indoor = [other.split("_")[0] in INDOOR for other in others]
            assert indoor == [True, False]
            assert light.split("_")[0] not in [other.split("_")[0] for other in others]
    assert {name for names in RELIGHTS.values() for name in names}.isdisjoint(lit)
    big = SUITES["S"].pairs
    assert len(big) == 16 and {name for name, _ in big} == set(OBJECTS)
    for name in OBJECTS:
        kinds = sorted(light.split("_")[0] in INDOOR for thing, light in big if thing == name)
        assert kinds == [False, True]


def test_two_studies_may_fill_one_folder(monkeypatch, tmp_path):
    """Each scene is made once, by one of them; both get all."""
    made = []

    def slowly(suite, thing, light, out, folder):
        time.sleep(0.05)
        made.append(folder.name)
        folder.mkdir()

    monkeypatch.setattr(make, "make_one", slowly)
    with ThreadPoolExecutor(2) as pool:
        first, second = pool.map(lambda _: make_suite("XS", tmp_path), range(2))
    assert first == second and all(folder.is_dir() for folder in first)
    assert sorted(made) == sorted(folder.name for folder in first)
    assert not list(tmp_path.glob(".*"))


def test_a_study_does_not_wait_for_scenes_that_it_does_not_want(monkeypatch, tmp_path):
    """While one scene is being made another process makes the next."""
    first, second = (make.scene_name("XS", *pair) for pair in SUITES["XS"].pairs[:2])
    begun, may_end = threading.Event(), threading.Event()

    def held_up(asset, light, others, options, folder):
        if folder.name == first:
            begun.set()
            assert may_end.wait(60)
        folder.mkdir()

    monkeypatch.setattr(make, "make_scene", held_up)
    monkeypatch.setattr(make, "write_object", lambda name, out, side: out.mkdir(parents=True))
    monkeypatch.setattr(make, "light_file", lambda folder, name: folder / name)
    with ThreadPoolExecutor(2) as pool:
        slow = pool.submit(make_suite, "XS", tmp_path, [first])
        assert begun.wait(60)
        assert make_suite("XS", tmp_path, [second]) == [tmp_path / second]
        assert not (tmp_path / first).exists()
        may_end.set()
        assert slow.result() == [tmp_path / first]


def test_an_unknown_scene_is_named_with_its_suite(tmp_path):
    with pytest.raises(InputError) as refused:
        make_suite("XS", tmp_path / "out", ["xs_vase__room_99"])
    assert str(refused.value).startswith("suite XS has no scene 'xs_vase__room_99'")
    assert not (tmp_path / "out").exists()
