"""Rendered scene folders: cameras, photos and truth of an asset that the test makes itself."""

import shutil

import numpy as np
import pytest

from benchmarks.make_scene import Options, load_scene, make_scene, render, sensor
from pipeline.base.errors import InputError
from pipeline.base.images import read_exr, read_png, srgb_to_linear, write_exr, write_png
from pipeline.geometry.cameras import Y_FROM_Z_UP, View
from pipeline.geometry.mesh_io import load_mesh
from pipeline.photos.given_cameras import read_transforms
from pipeline.photos.scene_files import find_photos

SIZE = 40
SMALL = Options(size=SIZE, spp=2, views=3, test=1)
COLOR = np.array([200, 100, 50])


@pytest.fixture
def asset(tmp_path, ball):
    """A ball of one colour, roughness 1 and no metal, as a folder."""
    folder = tmp_path / "asset"
    folder.mkdir()
    shutil.copy(ball / "mesh_uv.ply", folder / "mesh.ply")
    write_png(folder / "base_color.png", np.broadcast_to(COLOR, (4, 4, 3)))
    write_png(folder / "roughness.png", np.full((4, 4), 255))
    write_png(folder / "metallic.png", np.zeros((4, 4)))
    return folder


@pytest.fixture
def light(tmp_path):
    """An even light with one brighter half."""
    pixels = np.ones((8, 16, 3), np.float32)
    pixels[:, :8] = 3
    write_exr(tmp_path / "even.exr", pixels)
    return tmp_path / "even.exr"


def test_the_pipeline_reads_what_is_rendered(tmp_path, asset, light):
    scene = tmp_path / "scene"
    make_scene(asset, light, [light], SMALL, scene)
    photos = find_photos(scene)
    assert [split for _, _, split in photos] == ["fit"] * 3 + ["test"]

    sizes = {name: (SIZE, SIZE) for name, _, _ in photos}
    cameras = read_transforms(scene / "transforms.json", scene, sizes)
    cameras |= read_transforms(scene / "transforms_test.json", scene, sizes)
    points = load_mesh(scene / "mesh.ply").vertices @ Y_FROM_Z_UP[:3, :3].T
    for name, path, _ in photos:  # the mask is where the mesh projects to
        lens, pose = cameras[name]
        view = View(name, "", SIZE, SIZE, lens.fx, lens.fy, lens.cx, lens.cy, pose)
        uv, depth = view.project(points)
        rows, columns = np.nonzero(read_png(scene / "masks" / path.name))
        seen = [columns.min(), rows.min(), columns.max() + 1, rows.max() + 1]
        np.testing.assert_allclose(seen, [*uv.min(0), *uv.max(0)], atol=1.2)
        assert depth.min() > 0


def test_light_goes_through_an_asset_that_says_so(asset):
    """Seen from the dark side: lit there by what comes through alone."""
    behind = np.zeros((8, 16, 3), np.float32)
    behind[:, 7:9] = 5  # about the horizon's middle, +z
    behind[[0, 1, 6, 7]] = 0
    camera = sensor(np.array([0.0, 0.0, -4.0]), 16)
    shown = lambda: render(load_scene(asset, behind), camera, 64)[6:10, 6:10].mean()
    opaque = shown()
    write_png(asset / "transmission.png", np.full((4, 4), 255))
    assert shown() > 0.05 and opaque < 0.01


def test_truth_is_the_assets_own(tmp_path, asset, light):
    scene = tmp_path / "scene"
    factor = make_scene(asset, light, [light], SMALL, scene)["scale"]
    truth = scene / "truth"
    np.testing.assert_allclose(read_exr(truth / "envmap.exr"), factor * read_exr(light), rtol=1e-5)

    color = read_exr(truth / "albedo" / "test_000.exr")
    shown = color.sum(-1) > 0
    assert 0.05 < shown.mean() < 0.9
    true = np.broadcast_to(srgb_to_linear(COLOR / 255), color[shown].shape)
    np.testing.assert_allclose(color[shown], true, rtol=1e-5)
    assert read_exr(truth / "roughness" / "train_001.exr").max() == 1
    assert read_exr(truth / "metallic" / "train_001.exr").max() == 0

    own = read_exr(truth / "relight" / "test_000_self.exr")
    other = read_exr(truth / "relight" / "even" / "test_000.exr")
    assert own.shape == other.shape == (SIZE, SIZE, 3) and own.max() > 0 and other.max() > 0


def test_what_is_missing_or_in_the_way_is_named(tmp_path, asset, light):
    with pytest.raises(InputError, match=r"dark\.exr"):
        make_scene(asset, tmp_path / "dark.exr", [], SMALL, tmp_path / "scene")
    with pytest.raises(InputError, match="not empty"):
        make_scene(asset, light, [], SMALL, asset)
    (asset / "metallic.png").unlink()
    with pytest.raises(InputError, match=r"metallic\.png"):
        make_scene(asset, light, [], SMALL, tmp_path / "scene")
    assert not (tmp_path / "scene").exists()
