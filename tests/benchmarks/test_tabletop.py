"""Photos on a table: the thing stands on it, and the true cameras see it where the photos do."""

import shutil
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from benchmarks import tabletop
from benchmarks.masks import mask_errors
from benchmarks.tabletop import SIZE, Setting, of_matt, photograph, placed, true_views
from pipeline.base.images import write_exr, write_png
from pipeline.geometry.cameras import View
from pipeline.geometry.mesh_io import load_mesh
from pipeline.prior.training.data import is_held_out
from pipeline.surface.preview import Silhouette


@pytest.fixture
def asset(tmp_path, ball):
    """A red, matt ball without metal, as a folder."""
    folder = tmp_path / "asset"
    folder.mkdir()
    shutil.copy(ball / "mesh_uv.ply", folder / "mesh.ply")
    write_png(folder / "base_color.png", np.broadcast_to([220, 10, 10], (4, 4, 3)))
    write_png(folder / "roughness.png", np.full((4, 4), 255))
    write_png(folder / "metallic.png", np.zeros((4, 4)))
    return folder


def test_a_thing_stands_on_the_table_upright(asset):
    """Its longest side is SIZE, its lowest point touches, z-up became y-up."""
    mesh = load_mesh(asset / "mesh.ply")
    mesh.vertices[:] = mesh.vertices * [1, 1, 2] + [3, 4, 5]  # twice as high as wide, elsewhere
    on_table, matrix = placed(mesh)
    low, high = on_table.vertices.min(0), on_table.vertices.max(0)
    assert abs(low[1]) < 1e-6 and abs(high[1] - SIZE) < 1e-6
    np.testing.assert_allclose((low + high)[[0, 2]], 0, atol=1e-6)
    assert abs((high - low)[0] - SIZE / 2) < 0.02 * SIZE
    moved = mesh.vertices @ matrix[:3, :3].T + matrix[:3, 3]
    np.testing.assert_allclose(moved, on_table.vertices, atol=1e-9)


def test_the_true_cameras_see_the_thing_where_the_photos_do(tmp_path, asset, monkeypatch):
    monkeypatch.setattr(tabletop, "PHOTOS", 2)
    monkeypatch.setattr(tabletop, "SPP", 4)
    light = tmp_path / "even.exr"
    write_exr(light, np.ones((8, 16, 3), np.float32))
    grey = lambda rng: of_matt(np.full((4, 4, 3), 0.4), 0.9)
    out = tmp_path / "scene"
    photograph(asset, light, Setting("even", grey, 1), out)

    shown = Silhouette(load_mesh(out / "truth" / "mesh.ply"))
    for view in true_views(out):
        photo = np.asarray(Image.open(out / view.image)).astype(int)
        red = photo[..., 0] > 2 * photo[..., 1]
        covered = shown(view)
        assert (red & covered).sum() > 0.9 * (red | covered).sum()


def test_assets_are_the_given_ones_or_made(tmp_path):
    """An object of the suite is made once, and its mesh can be laid on the table."""
    assert tabletop.asset_of("suzanne", tmp_path, tmp_path / "out") == tmp_path / "suzanne"
    made = tabletop.asset_of("bowl", tmp_path, tmp_path / "out")
    written = (made / "metallic.png").stat().st_mtime_ns
    assert tabletop.asset_of("bowl", tmp_path, tmp_path / "out") == made
    assert (made / "metallic.png").stat().st_mtime_ns == written
    assert placed(load_mesh(made / "mesh.ply"))[0].vertices[:, 1].min() == pytest.approx(
        0, abs=1e-9
    )


def test_masks_are_measured_against_the_true_silhouette(tmp_path, ball):
    """A mask of half the size misses what it lacks and adds what it has beside the object."""
    mesh = load_mesh(ball / "mesh_uv.ply")
    pose = np.eye(4)
    pose[2, 3] = 4 * np.abs(mesh.vertices).max()
    view = View("v", "", 80, 60, 80.0, 80.0, 40.0, 30.0, pose)
    true = Silhouette(mesh)(view.at_size(40, 30))
    mask = true.copy()
    rows, columns = np.nonzero(true)
    mask[rows[:10], columns[:10]] = False  # missed
    mask[0, :5] = True  # added
    write_png(tmp_path / "v.png", mask * np.uint8(255))

    found = mask_errors(tmp_path, mesh, [view, replace(view, name="without")])
    size = true.sum()
    assert found["missed"] == 10 / size and found["added"] == 5 / size
    assert found["iou"] == pytest.approx((size - 10) / (size + 5))
    with pytest.raises(ValueError, match="no view of the truth has a mask"):
        mask_errors(tmp_path, mesh, [])


def test_no_light_or_camera_is_used_twice_and_the_last_lights_are_held_out_of_the_priors():
    settings = list(tabletop.THINGS.values())
    assert len({setting.light for setting in settings}) == len(settings)
    assert len({setting.seed for setting in settings}) == len(settings)
    assert all(is_held_out(setting.light) for setting in settings if setting.seed >= 17)
