"""Readers of public data sets: each is given a small folder in the set's own layout, whose truth is
known, and must bring cameras, colours, masks and the light's frame over; what a set lacks is said,
and what is missing of it is named.
"""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from benchmarks.layouts.__main__ import convert
from benchmarks.layouts.content import Options
from benchmarks.layouts.maps import blender_uv, in_our_frame, skylibs_uv
from pipeline.base.errors import InputError
from pipeline.base.files import read_json, write_json
from pipeline.base.images import linear_to_srgb, write_exr
from pipeline.geometry.cameras import Y_FROM_Z_UP
from pipeline.render.light_metrics import peak_direction
from pipeline.report.score import score_explanation
from pipeline.report.truth import load_truth

ROOT = Path(__file__).resolve().parents[2]
W, H, ANGLE = 24, 16, 0.7
COLOR = np.array([0.1, 0.35, 0.6])
ALBEDO = np.array([0.2, 0.5, 0.7])
TO_Y_UP = Y_FROM_Z_UP[:3, :3]
SPLITS = {"train": 4, "test": 2}


def outline() -> np.ndarray:
    """A disc, and one pixel above the middle, so that a flipped picture is another."""
    y, x = np.mgrid[:H, :W]
    disc = (x - 11.5) ** 2 + (y - 7.5) ** 2 < 25
    disc[1, 4] = True
    return disc


def pose(k: int) -> np.ndarray:
    """Camera to world, OpenGL axes, Z-up, on a ring, looking at the origin."""
    a = 0.3 + 2 * np.pi * k / 6
    eye = np.array([3 * np.cos(a), 3 * np.sin(a), 0.8 + 0.2 * k])
    back = eye / np.linalg.norm(eye)
    right = np.cross([0, 0, 1], back)
    right /= np.linalg.norm(right)
    out = np.eye(4)
    out[:3] = np.stack([right, np.cross(back, right), back, eye], 1)
    return out


def views(split: str) -> list[tuple[int, np.ndarray]]:
    """Numbers within the split, and poses."""
    first = 0 if split == "train" else SPLITS["train"]
    return [(k, pose(first + k)) for k in range(SPLITS[split])]


def picture(brightness: float = 1.0) -> np.ndarray:
    """Linear (h, w, 3), brighter from left to right, black beside the object."""
    ramp = np.linspace(0.5, 1, W)[None, :, None]
    return brightness * COLOR * ramp * outline()[..., None]


def save_rgba(file: Path, linear: np.ndarray) -> None:
    """sRGB with straight alpha; garbage under alpha 0, as Blender leaves it."""
    file.parent.mkdir(parents=True, exist_ok=True)
    color = np.where(outline()[..., None], linear_to_srgb(linear), 0.9)
    rgba = np.concatenate([color, outline()[..., None]], -1)
    Image.fromarray(np.round(255 * rgba).astype(np.uint8)).save(file)


def save_rgb(file: Path, linear: np.ndarray) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    eight = np.round(255 * linear_to_srgb(linear)).astype(np.uint8)
    Image.fromarray(eight).save(file, **({"quality": 100} if file.suffix == ".JPG" else {}))


def save_mask(file: Path, white: int = 255) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray((outline() * white).astype(np.uint8)).save(file)


def save_map(file: Path, row: int, column: int, dim: float = 0.1) -> None:
    """A light of 32 rows, dim but for one pixel."""
    light = np.full((32, 64, 3), dim, np.float32)
    light[row, column] = 500.0
    write_exr(file, light)


def frames(split: str, name: str) -> list[dict]:
    return [
        {"file_path": name.format(split=split, k=k), "transform_matrix": p.tolist()}
        for k, p in views(split)
    ]


def nerf_synthetic(folder: Path) -> Path:
    for split in SPLITS:
        data = {"camera_angle_x": ANGLE, "frames": frames(split, "./{split}/r_{k}")}
        write_json(folder / f"transforms_{split}.json", data)
        for k, _ in views(split):
            save_rgba(folder / split / f"r_{k}.png", picture())
    return folder


def tensoir(folder: Path) -> Path:
    """Maps lie beside it: sunset's sun towards +X (the middle of Blender's picture), city's towards
    -Y (three quarters).
    """
    save_map(folder.parent / "maps" / "sunset.exr", 15, 32)
    save_map(folder.parent / "maps" / "city.exr", 15, 48)
    for split in SPLITS:
        for k, p in views(split):
            view = folder / f"{split}_{k:03d}"
            about = {
                "cam_transform_mat": ",".join(map(str, p.ravel())),
                "cam_angle_x": ANGLE,
                "imw": W,
                "imh": H,
            }
            write_json(view / "metadata.json", about)
            save_rgba(view / "rgba_sunset.png", picture())
            save_rgba(view / "rgba_city.png", picture(0.5))
            albedo = np.round(255 * ALBEDO * outline()[..., None]).astype(np.uint8)  # linear
            Image.fromarray(albedo).save(view / "albedo.png")
    return folder


def stanford_orb(folder: Path) -> Path:
    """Each map's lamp is in its middle: where its own camera looks."""
    here, there = "thing_scene001", "thing_scene002"
    scene = folder / "blender_LDR" / here
    for split in SPLITS:
        data = {"camera_angle_x": ANGLE, "frames": frames(split, "{split}/{k:04d}")}
        write_json(scene / f"transforms_{split}.json", data)
        for k, _ in views(split):
            save_rgb(scene / split / f"{k:04d}.png", picture())
            write_exr(folder / "blender_HDR" / here / split / f"{k:04d}.exr", 2 * picture())
            save_mask(scene / f"{split}_mask" / f"{k:04d}.png")
    novel = frames("test", "test/{k:04d}")
    for frame in novel:
        frame |= {"scene_name": there, "camera_angle_x": 0.5}
    write_json(scene / "transforms_novel.json", {"frames": novel})
    truth = folder / "ground_truth"
    for k, _ in views("test"):
        save_rgb(folder / "blender_LDR" / there / "test" / f"{k:04d}.png", picture(0.5))
        save_mask(folder / "blender_LDR" / there / "test_mask" / f"{k:04d}.png")
        save_map(truth / here / "env_map" / f"{k:04d}.exr", 15, 32)
        save_map(truth / there / "env_map" / f"{k:04d}.exr", 15, 32)
        save_rgb(truth / here / "pseudo_gt_albedo" / f"{k:04d}.png", np.tile(ALBEDO, (H, W, 1)))
    return scene


def open_illumination(folder: Path, opencv: bool = True) -> Path:
    """Cameras C0 to C5 with OpenCV's axes, or OpenGL's."""
    turn = np.diag([1, -1, -1, 1]) if opencv else np.eye(4)
    save_map(folder.parent / "maps" / "013.exr", 15, 32)
    for split, first in (("train", 0), ("test", SPLITS["train"])):
        of = {
            f"C{first + k}": {
                "file_path": f"C{first + k}",
                "transform_matrix": (p @ turn).tolist(),
                "camera_angle_x": ANGLE,
                "calib_imgw": W,
            }
            for k, p in views(split)
        }
        write_json(folder / "output" / f"transforms_alignz_{split}.json", {"frames": of})
        for camera in of:
            for pattern, brightness in (("013", 1.0), ("009", 0.5)):
                place = folder / "Lights" / pattern / "raw_undistorted"
                save_rgb(place / f"{camera}.JPG", picture(brightness))
            for masks in ("com_masks", "obj_masks"):
                save_mask(folder / "output" / masks / f"{camera}.png", white=1)
    return folder


MAKE = {
    "nerf_synthetic": nerf_synthetic,
    "tensoir": tensoir,
    "stanford_orb": stanford_orb,
    "open_illumination": open_illumination,
}


def converted(layout: str, folder: Path, **options) -> Path:
    """The scene folder of a small set below `folder`."""
    source = MAKE[layout](folder / "set")
    if layout in ("tensoir", "open_illumination"):
        options = {"lights": folder / "maps"} | options
    if layout == "tensoir":
        options = {"light": "sunset"} | options
    convert(layout, source, folder / "scene", Options(**options))
    return folder / "scene"


@pytest.mark.parametrize("layout", MAKE)
def test_cameras_pictures_and_masks_come_over(layout, tmp_path):
    scene = converted(layout, tmp_path)
    for split, file in (("train", "transforms.json"), ("test", "transforms_test.json")):
        found = read_json(scene / file)["frames"]
        assert len(found) == SPLITS[split]
        for frame, (_, true) in zip(found, views(split)):
            np.testing.assert_allclose(frame["transform_matrix"], true, atol=1e-9)
            assert frame["fl_x"] == pytest.approx(0.5 * W / np.tan(0.5 * ANGLE))
            assert (frame["w"], frame["h"], frame["cx"], frame["cy"]) == (W, H, W / 2, H / 2)
            name = Path(frame["file_path"]).stem
            shown = np.asarray(Image.open(scene / frame["file_path"]))[..., :3] / 255
            at = outline() if layout != "open_illumination" else np.s_[5:10, 9:14]  # JPEG's rims
            np.testing.assert_allclose(shown[at], linear_to_srgb(picture())[at], atol=0.02)
            mask = np.asarray(Image.open(scene / "masks" / f"{name}.png")) > 127
            np.testing.assert_array_equal(mask, outline())


def test_a_picture_beside_alpha_is_black(tmp_path):
    scene = converted("nerf_synthetic", tmp_path)
    shown = np.asarray(Image.open(scene / "images" / "train_r_0.png"))
    assert not shown[~outline()].any()


def test_what_nerf_synthetic_lacks_is_said(tmp_path):
    truth = load_truth(converted("nerf_synthetic", tmp_path))
    assert truth.light is None and not truth.relights and not truth.views[0].maps
    assert any("only novel views" in note for note in truth.notes)
    with pytest.raises(InputError, match="no light"):
        truth.known_light()


def test_tensoir_has_lights_in_our_frame_and_linear_base_colour(tmp_path):
    truth = load_truth(converted("tensoir", tmp_path))
    towards = lambda light: peak_direction(light)
    np.testing.assert_allclose(towards(truth.known_light()), TO_Y_UP @ [1, 0, 0], atol=0.1)
    assert list(truth.relights) == ["city"]
    city = truth.relights["city"]
    np.testing.assert_allclose(towards(city.light), TO_Y_UP @ [0, -1, 0], atol=0.1)
    np.testing.assert_allclose(city.pictures[0].pixels, picture(0.5), atol=0.01)
    albedo = truth.views[0].maps["albedo"][outline()]
    np.testing.assert_allclose(albedo, np.tile(ALBEDO, (len(albedo), 1)), atol=0.01)


def test_stanford_orbs_maps_turn_with_their_cameras(tmp_path):
    truth = load_truth(converted("stanford_orb", tmp_path))
    first = views("test")[0][1]
    ahead = TO_Y_UP @ -first[:3, 2]
    np.testing.assert_allclose(peak_direction(truth.known_light()), ahead, atol=0.1)
    np.testing.assert_allclose(truth.views[0].photo.pixels, 2 * picture(), atol=0.01)  # of HDR
    np.testing.assert_allclose(truth.views[0].maps["albedo"][8, 12], ALBEDO, atol=0.01)

    assert list(truth.relights) == ["thing_scene002_0000", "thing_scene002_0001"]
    for (_, p), relit in zip(views("test"), truth.relights.values()):
        np.testing.assert_allclose(peak_direction(relit.light), TO_Y_UP @ -p[:3, 2], atol=0.1)
        (own,) = relit.views
        assert own.view.fx == pytest.approx(0.5 * W / np.tan(0.25))
        np.testing.assert_allclose(relit.pictures[0].pixels, picture(0.5), atol=0.01)


@pytest.mark.parametrize("opencv", [True, False])
def test_open_illumination_tells_axes_by_where_cameras_look(tmp_path, opencv):
    source = open_illumination(tmp_path / "set", opencv)
    about = convert("open_illumination", source, tmp_path / "scene", Options())
    found = read_json(tmp_path / "scene" / "transforms.json")["frames"]
    np.testing.assert_allclose(found[0]["transform_matrix"], pose(0), atol=1e-9)
    assert any(("OpenCV" if opencv else "OpenGL") in note for note in about["notes"])
    assert not about["light"] and any("no map" in note for note in about["notes"])


def test_maps_poles_and_seam():
    """Zenith stays zenith; a picture of -X, at Blender's seam, is whole on ours."""
    light = np.zeros((32, 64, 3), np.float32)
    light[0], light[15, [0, -1]] = 1.0, 50.0
    turned = in_our_frame(light, blender_uv, np.eye(3), 32)
    assert turned[0].mean() > 0.4 > turned[-1].mean()
    np.testing.assert_allclose(peak_direction(turned), TO_Y_UP @ [-1, 0, 0], atol=0.1)
    assert turned.max() > 40

    right = np.array([[1.0, 0, 0]])
    assert skylibs_uv(right)[0][0] == pytest.approx(0.75)


def test_pictures_are_scaled_down_and_views_chosen(tmp_path):
    scene = converted("nerf_synthetic", tmp_path, side=12, train=3, test=1)
    found = read_json(scene / "transforms.json")["frames"]
    assert len(found) == 3 and (found[0]["w"], found[0]["h"]) == (12, 8)
    assert found[0]["fl_x"] == pytest.approx(6 / np.tan(0.5 * ANGLE))


MISSING = [
    ("nerf_synthetic", "transforms_test.json", "transforms_test.json"),
    ("nerf_synthetic", "train/r_1.png", "r_1.png"),
    ("tensoir", "train_001/metadata.json", "metadata.json"),
    ("tensoir", "test_001/rgba_sunset.png", "rgba_sunset.png"),
    ("stanford_orb", "train_mask/0002.png", "0002.png"),
    ("open_illumination", "output/transforms_alignz_test.json", "transforms_alignz_test.json"),
    ("open_illumination", "Lights/013/raw_undistorted/C1.JPG", "C1.JPG"),
]


@pytest.mark.parametrize(("layout", "file", "named"), MISSING)
def test_what_is_missing_is_named(layout, file, named, tmp_path):
    source = MAKE[layout](tmp_path / "set")
    (source / file).unlink()
    light = {"light": "sunset"} if layout == "tensoir" else {}
    with pytest.raises(InputError) as found:
        convert(layout, source, tmp_path / "scene", Options(**light))
    assert named in str(found.value) and "what to do" in str(found.value)
    assert not (tmp_path / "scene").exists()


def test_tensoir_asks_which_light_the_photos_are_from(tmp_path):
    source = tensoir(tmp_path / "set")
    with pytest.raises(InputError, match="--light"):
        convert("tensoir", source, tmp_path / "scene", Options())
    about = {"cam_transform_mat": "1,2,3", "cam_angle_x": ANGLE}
    write_json(source / "train_000" / "metadata.json", about)
    with pytest.raises(InputError, match="16 numbers"):
        convert("tensoir", source, tmp_path / "scene", Options(light="sunset"))


def test_command_and_unknown_names(tmp_path):
    source = nerf_synthetic(tmp_path / "set")
    command = [sys.executable, "-m", "benchmarks.layouts", "--from", str(source)]
    command += ["--out", str(tmp_path / "scene"), "--layout"]
    done = subprocess.run([*command, "nerf_syntetic"], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 2 and "nerf_synthetic" in done.stderr
    done = subprocess.run([*command, "nerf_synthetic"], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert json.loads((tmp_path / "scene" / "truth" / "layout.json").read_text())["photos"] == 4


def test_scores_without_truth_are_left_out(tmp_path, ball):
    """An asset is scored by novel views alone where that is all there is."""
    from pipeline.render.renderer import Explanation, Renderer

    truth = load_truth(converted("nerf_synthetic", tmp_path))
    gloss = np.full((16, 16), 0.5, np.float32)
    x = Explanation(
        np.ones((16, 32, 3), np.float32), np.full((16, 16, 3), 0.5, np.float32), gloss, 0 * gloss
    )
    found = score_explanation(Renderer(ball / "mesh_uv.ply", 16, 16, 3), x, truth, 4).values
    assert set(found) == {"novel_view_psnr", "novel_view_ssim", "novel_view_flip"}
