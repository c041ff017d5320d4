import numpy as np
import pytest

from pipeline.base.config import Masks
from pipeline.base.errors import InputError
from pipeline.base.images import read_png, write_exr, write_png
from pipeline.geometry.cameras import Rig, save_cameras
from pipeline.masks.make import make_masks
from tests.surface.test_surface import silhouettes


@pytest.fixture
def table(tmp_path, ring):
    """A ball with painted cubes of colour on a table with grey noise; truth masks."""
    rng = np.random.default_rng(0)
    noise = rng.uniform(0.25, 0.75, (64, 64))
    views = [v for e in (28, 60) for v in ring(10, 200, 3.0, e) if v.position[1] > 0]
    for k, v in enumerate(views):
        v.name, v.image = f"p{k}", f"images/p{k}.exr"
    truth = silhouettes(views, 0.45)
    for v in views:
        u, w = np.meshgrid(np.arange(v.width) + 0.5, np.arange(v.height) + 0.5)
        o, d = v.rays(np.stack([u, w], -1))
        t = (-0.45 - o[..., 1]) / np.minimum(d[..., 1], -1e-3)
        p = o + t[..., None] * d
        shade = noise[(p[..., 0] * 8).astype(int) % 64, (p[..., 2] * 8).astype(int) % 64]
        b = (o * d).sum(-1)
        q = o + (-b - np.sqrt(np.maximum(b**2 - (o**2).sum(-1) + 0.45**2, 0)))[..., None] * d
        paint = np.array([[0.5, 0.12, 0.05], [0.05, 0.1, 0.5], [0.1, 0.4, 0.05]])[
            np.floor(q * 5).astype(int).sum(-1) % 3
        ]
        image = np.where(truth[v.name][..., None], paint, np.repeat(shade[..., None], 3, -1))
        write_exr(tmp_path / v.image, image)
    rig = Rig(
        views, np.array([0, 0, 0.0]), 0.6, "sfm", {"plane": {"normal": [0, 1, 0], "offset": -0.45}}
    )
    save_cameras(tmp_path / "cameras.json", rig)
    return tmp_path, rig, truth


@pytest.mark.slow
def test_object_is_told_from_its_table(table, tmp_path):
    folder, rig, truth = table
    out = tmp_path / "out"
    out.mkdir()
    assert make_masks(folder, out, Masks(), 2)["method"] == "plane"
    recall, overlap = [], []
    for v in rig.views:
        mask = read_png(out / "masks" / f"{v.name}.png") > 127
        recall.append((mask & truth[v.name]).sum() / truth[v.name].sum())
        overlap.append((mask & truth[v.name]).sum() / (mask | truth[v.name]).sum())
    # Nothing of the object is lost. Ground at its foot that no view sees bare may stay: stereo
    # takes it off later.
    assert min(recall) > 0.97
    assert np.mean(overlap) > 0.8


def test_given_masks_win_and_missing_ones_are_named(table, tmp_path):
    folder, rig, truth = table
    for v in rig.views:
        write_png(folder / "masks" / f"{v.name}.png", truth[v.name] * np.uint8(255))
    out = tmp_path / "out"
    out.mkdir()
    assert make_masks(folder, out, Masks(), 2)["method"] == "given"
    assert (read_png(out / "masks" / f"{rig.views[0].name}.png") > 127).sum() == truth[
        rig.views[0].name
    ].sum()
    (folder / "masks" / f"{rig.views[2].name}.png").unlink()
    with pytest.raises(InputError, match=rig.views[2].name):
        make_masks(folder, tmp_path, Masks(), 2)


def test_without_a_ground_plane_the_cure_is_told(table, tmp_path):
    folder, rig, _ = table
    rig.facts["plane"] = None
    save_cameras(folder / "cameras.json", rig)
    with pytest.raises(InputError, match="folder masks/"):
        make_masks(folder, tmp_path, Masks(), 2)


def test_network_back_end_needs_its_file(table, tmp_path):
    with pytest.raises(InputError, match="no such network"):
        make_masks(table[0], tmp_path, Masks(method="onnx", onnx_model="/nowhere.onnx"), 2)
