"""One rendered scene, put into the layouts of four public data sets and read back: the right asset
scores well in each, what a set lacks is not scored, and what is wrong in a folder is named.
"""

import json
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from benchmarks.layouts import __main__ as command
from benchmarks.layouts.__main__ import convert
from benchmarks.layouts.content import Content, Options, Relit, Shot
from benchmarks.layouts.pictures import load
from benchmarks.layouts.write import write_scene
from pipeline.base.errors import InputError
from pipeline.base.images import read_exr, read_png, srgb_to_linear, write_exr
from pipeline.geometry.cameras import Y_FROM_Z_UP
from pipeline.render.envmap import directions, solid_angles
from pipeline.render.renderer import Explanation, Renderer
from pipeline.report.score import MAX_DEPTH, score_asset, score_draws, score_explanation, table
from pipeline.report.truth import cameras_of, load_truth
from pipeline.usd.write import export
from tests.benchmarks import layout_folders
from tests.benchmarks.layout_folders import ROWS, SIZE, WRITERS, make_toy

LAYOUTS = list(WRITERS)
LIT = LAYOUTS[1:]  # those that have lights
SPP = 64  # with fewer the paths' noise makes the score, 32 dB and less at 16


@pytest.fixture(scope="module")
def toy(ball, tmp_path_factory):
    return make_toy(ball / "mesh_uv.ply", tmp_path_factory.mktemp("toy"))


@pytest.fixture(scope="module")
def sets(toy, tmp_path_factory):
    """The folder to convert, by layout."""
    root = tmp_path_factory.mktemp("sets")
    return {name: write(toy, root / name) for name, write in WRITERS.items()}


def options_for(layout: str, folder: Path, **more) -> Options:
    """folder: what is converted; maps lie beside it in lights/."""
    named = layout in ("tensoir", "open_illumination")
    lights = {"lights": folder.parent / "lights"} if named else {}
    light = {"light": "sunset"} if layout == "tensoir" else {}
    return Options(**(lights | light | more))


@pytest.fixture(scope="module")
def scenes(sets, tmp_path_factory):
    """The scene folder made of each layout's."""
    root = tmp_path_factory.mktemp("scenes")
    for layout, folder in sets.items():
        convert(layout, folder, root / layout, options_for(layout, folder))
    return {layout: root / layout for layout in sets}


@pytest.fixture
def own_copy(sets, tmp_path):
    """A layout's folders to spoil; returns the one to convert."""

    def copied(layout: str) -> Path:
        root = sets["nerf_synthetic"].parent / layout
        shutil.copytree(root, tmp_path / "set")
        return tmp_path / "set" / sets[layout].relative_to(root)

    return copied


# --- what comes out ---------------------------------------------------------------------------


@pytest.mark.parametrize("layout", LAYOUTS)
def test_colours(layout, toy, scenes):
    """Photos are sRGB of 8 bits, truth is linear; Stanford-ORB's keeps its range."""
    lossy = 0.1 if layout == "open_illumination" else 0.006  # JPEG
    for k, name in enumerate(toy.names("test")):
        inside = load_truth(toy.scene).views[k].mask
        true = toy.linear(name)[inside]
        shown = load_truth(scenes[layout]).views[k].photo.pixels[inside]
        if layout == "open_illumination":
            assert np.abs(shown - np.clip(true, 0, 1)).mean() < 0.01
        elif layout == "stanford_orb":
            np.testing.assert_allclose(shown, true, rtol=1e-5)
        else:
            np.testing.assert_allclose(shown, np.clip(true, 0, 1), atol=lossy)

    photo = cameras_of(scenes[layout], scenes[layout] / "transforms.json")[0][0]
    name = toy.names("train")[0]
    pixels = srgb_to_linear(read_png(photo) / 255)
    np.testing.assert_allclose(
        pixels[toy.mask(name)], np.clip(toy.linear(name), 0, 1)[toy.mask(name)], atol=lossy
    )


def test_alpha_is_straight_and_the_scene_on_black(tmp_path):
    """A pixel half covered by a bright object is half as bright, and the object's or not by which
    half is larger.
    """
    rgba = np.zeros((8, 8, 4), np.uint8)
    rgba[..., :3] = 200
    rgba[:, 2:, 3] = 100, 129, 200, 255, 255, 255
    layout_folders.write_picture(tmp_path / "p.png", rgba)
    linear, outline = load(Shot("p", tmp_path / "p.png", np.eye(4), 0.7), None)
    light = srgb_to_linear(np.array(200 / 255))
    np.testing.assert_allclose(linear[3, :, 1], light * rgba[3, :, 3] / 255, atol=1e-6)
    assert outline[3].tolist() == [False] * 3 + [True] * 5

    # means of light, and of what is shown of the object
    half, outline = load(Shot("p", tmp_path / "p.png", np.eye(4), 0.7), 4)
    np.testing.assert_allclose(half[1, 1], light * (100 + 129) / 510, rtol=1e-5)
    assert half.shape == (4, 4, 3) and outline[1].tolist() == [False, False, True, True]


@pytest.mark.parametrize("layout", ["tensoir", "stanford_orb"])
def test_base_colour(layout, toy, scenes):
    """TensoIR's is linear, Stanford-ORB's encoded."""
    for view, name in zip(load_truth(scenes[layout]).views, toy.names("test")):
        shown, true = view.maps["albedo"][view.mask], toy.albedo(name)[view.mask]
        np.testing.assert_allclose(shown, true, atol=0.006)
        assert set(view.maps) == {"albedo"}


# place in a map (u, v) -> direction, in Blender's world and in Stanford-ORB's camera
TOWARD = {(0.5, 0.5): (1, 0, 0), (0.75, 0.5): (0, -1, 0), (0.25, 0.5): (0, 1, 0)}
IN_CAMERA = dict(zip(TOWARD, [(0, 0, -1), (1, 0, 0), (-1, 0, 0)]))


@pytest.mark.parametrize("layout", LIT)
@pytest.mark.parametrize("place", list(TOWARD))
def test_a_bright_pixel_comes_from_the_right_side(layout, place, toy, own_copy, tmp_path):
    """Blender's maps have +X in the middle and -Y at three quarters; Stanford-ORB's what the camera
    looks at, and its right. What is on top is bright too, but less.
    """
    folder = own_copy(layout)
    if layout == "stanford_orb":
        file = folder.parents[1] / "ground_truth" / folder.name / "env_map" / "0000.exr"
        turn = toy.poses["test_000"][:3, :3]
        toward, up = turn @ IN_CAMERA[place], turn[:, 1]
    else:
        name = {"tensoir": "sunset", "open_illumination": "013"}[layout]
        file = folder.parent / "lights" / f"{name}.exr"
        toward, up = np.array(TOWARD[place]), np.array([0, 0, 1])
    spot = np.full((ROWS, 2 * ROWS, 3), 0.01, np.float32)
    spot[:2] = 1
    spot[int(place[1] * ROWS), int(place[0] * 2 * ROWS)] = 100, 50, 25
    write_exr(file, spot)

    few = {"train": 3, "test": 1}
    convert(layout, folder, tmp_path / "out", options_for(layout, folder, **few))
    light = read_exr(tmp_path / "out" / "truth" / "envmap.exr")
    world = directions(*light.shape[:2]) @ Y_FROM_Z_UP[:3, :3]  # Z-up
    peak = np.unravel_index(light[..., 0].argmax(), light.shape[:2])
    assert np.degrees(np.arccos(world[peak] @ toward)) < 7, f"{world[peak]} is not {toward}"
    np.testing.assert_allclose(light[peak] / light[peak][0], [1, 0.5, 0.25], rtol=0.01)
    assert light[world @ up > np.cos(np.radians(8))].min() > 0.5
    flux = [(env * solid_angles(*env.shape[:2])[..., None]).sum() for env in (light, spot)]
    assert flux[0] == pytest.approx(flux[1], rel=0.2)  # a few directions a pixel


# --- scores -----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def judged(toy, ball):
    """renderer and the toy's true explanation."""
    color = np.full((16, 16, 3), layout_folders.BASE_COLORS[0])
    color[:, 8:] = layout_folders.BASE_COLORS[1]
    grey = lambda value: np.full((16, 16), value, np.float32)
    light = read_exr(toy.scene / "truth" / "envmap.exr")
    linear = srgb_to_linear(color / 255).astype(np.float32)
    x = Explanation(light, linear, grey(128 / 255), grey(0))
    return Renderer(ball / "mesh_uv.ply", 16, ROWS, MAX_DEPTH), x


@pytest.mark.slow
@pytest.mark.parametrize("layout", LIT)
def test_the_right_asset_scores_well(layout, scenes, judged):
    """Cameras, lights' frames and strengths, relit views and base colour belong together: with a
    light turned by a quarter the score falls.
    """
    renderer, x = judged
    truth = load_truth(scenes[layout])
    assert len(truth.relights) == (2 if layout == "stanford_orb" else 1)
    found = score_explanation(renderer, x, truth, SPP).values
    assert found["novel_view_psnr"] > 32 and found["relight_psnr"] > 32
    assert found["sun_degrees"] < 3 and found["light_psnr_log"] > 30
    assert ("albedo_mse" in found) == (layout != "open_illumination")
    assert found.get("albedo_mse", 0) < 1e-4
    assert not {"roughness_mse", "metallic_mse"} & set(found)

    for relit in truth.relights.values():
        relit.light = np.roll(relit.light, ROWS // 2, 1)
    assert score_explanation(renderer, x, truth, SPP).values["relight_psnr"] < 25


def test_what_a_set_lacks_is_not_scored_and_said(scenes, judged, ball, tmp_path):
    renderer, x = judged
    truth = load_truth(scenes["nerf_synthetic"])
    assert truth.light is None and not truth.relights
    with pytest.raises(InputError, match="the truth has no light"):
        truth.known_light()

    x.save(tmp_path / "sample0")
    export(ball, [tmp_path / "sample0"], tmp_path / "ball.usda", {"preset": "draft"})
    found = score_asset(tmp_path / "ball.usda", truth, SPP)
    scores = found["samples"]["sample_0"]["scores"]
    assert set(scores) == {
        "novel_view_psnr",
        "novel_view_ssim",
        "novel_view_flip",
        "outline_overlap",
    }
    assert scores["novel_view_psnr"] > 32
    text = table(found)
    assert "only novel views are scored" in text and "relight PSNR" not in text

    draw = score_explanation(renderer, x, truth, 2)
    assert score_draws([draw, draw], truth) == {"variance_light": 0}


def test_notes_name_what_was_left_out(sets, scenes):
    notes = {layout: " / ".join(load_truth(scenes[layout]).notes) for layout in LAYOUTS}
    assert "night are left out" in notes["tensoir"]
    assert "no scale" in notes["stanford_orb"] and "8 bits" not in notes["stanford_orb"]
    for what in ("OpenCV's", "no base colour"):
        assert what in notes["open_illumination"]
    about = json.loads((scenes["tensoir"] / "truth" / "layout.json").read_text())
    assert about["relights"] == ["city"] and about["albedo"] and about["light"]


def test_without_its_other_parts_stanford_orb_is_taken_as_it_is(toy, own_copy, tmp_path):
    folder = own_copy("stanford_orb")
    shutil.rmtree(folder.parents[1] / "blender_HDR")
    shutil.rmtree(folder.parents[1] / "ground_truth")
    convert("stanford_orb", folder, tmp_path / "out", Options())
    truth = load_truth(tmp_path / "out")
    said = " / ".join(truth.notes)
    assert truth.light is None and not truth.relights and "albedo" not in truth.views[0].maps
    for what in ("compared with 8 bits", "light is not scored", "base colour", "ball_scene002"):
        assert what in said


def test_photos_of_high_range_are_written_as_such(toy, sets, tmp_path):
    folder = sets["stanford_orb"].parents[1] / "blender_HDR" / "ball_scene001"
    convert("stanford_orb", folder, tmp_path / "out", Options(train=3, test=1))
    photo = read_exr(tmp_path / "out" / "images" / "train_0000.exr")
    inside = toy.mask("train_000")
    np.testing.assert_allclose(photo[inside], toy.linear("train_000")[inside], rtol=1e-5)
    assert load_truth(tmp_path / "out").views[0].view.width == SIZE


# --- choices ----------------------------------------------------------------------------------


def test_fewer_and_smaller_pictures(sets, tmp_path, monkeypatch, capsys):
    words = ["--layout", "tensoir", "--from", str(sets["tensoir"]), "--out", str(tmp_path / "out")]
    words += ["--lights", str(sets["tensoir"].parent / "lights"), "--light", "sunset"]
    words += ["--train", "3", "--test", "1", "--side", "20", "--light-rows", "8"]
    monkeypatch.setattr(sys, "argv", ["layouts", *words, "--relights", "city"])
    command.main()
    said = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert (said["photos"], said["held_out"], said["relights"]) == (3, 1, ["city"])

    truth = load_truth(tmp_path / "out")
    view = truth.views[0].view
    assert (view.width, view.height, view.cx) == (20, 20, 10)
    assert view.fx == pytest.approx(10 / np.tan(np.radians(20)))
    assert truth.views[0].maps["albedo"].shape == truth.views[0].photo.pixels.shape == (20, 20, 3)
    assert truth.light.shape == (8, 16, 3)

    monkeypatch.setattr(sys, "argv", ["layouts", *words, "--side", "2"])
    with pytest.raises(InputError, match="give 8 or more"):
        command.main()


def test_the_photos_light_by_its_metadata(own_copy, toy, tmp_path):
    """NeRFactor's rgba.png is lit by the map and strength that metadata.json names."""
    folder = own_copy("tensoir")
    for view in folder.iterdir():
        (view / "rgba_sunset.png").rename(view / "rgba.png")
    shutil.copy(folder.parent / "lights" / "sunset.exr", folder.parent / "lights" / "elsewhere.exr")
    convert("tensoir", folder, tmp_path / "out", options_for("tensoir", folder, light=None))
    light = read_exr(tmp_path / "out" / "truth" / "envmap.exr")
    true = 3 * layout_folders.our_map(toy.own)
    np.testing.assert_allclose(light, true, rtol=1e-4)


@pytest.mark.parametrize("name", ["../x", "a/b", "..", "", "a\0"])
def test_names_of_a_set_lead_out_of_no_folder(name, tmp_path):
    shot = Shot(name, tmp_path / "p.png", np.eye(4), 0.7)
    others = [replace(shot, name=str(k)) for k in range(3)]
    with pytest.raises(InputError, match="cannot be a file's"):
        write_scene("tensoir", Content(others, [shot]), tmp_path / "out")
    with pytest.raises(InputError, match="the name of a light"):
        relit = [Relit(name, lambda: np.ones((4, 8, 3)), others[:1])]
        write_scene("tensoir", Content(others, [], relights=relit), tmp_path / "out")


def test_open_illuminations_axes_are_found(toy, scenes, tmp_path):
    """OpenGL's axes, as OpenCV's, lead to the same cameras; a mixture is refused."""
    folder = layout_folders.open_illumination(toy, tmp_path / "gl", np.eye(4))
    convert("open_illumination", folder, tmp_path / "out", Options())
    mine = cameras_of(tmp_path / "out", tmp_path / "out" / "transforms.json")
    same = scenes["open_illumination"]
    for (_, one), (_, other) in zip(mine, cameras_of(same, same / "transforms.json")):
        np.testing.assert_allclose(one.world_to_camera, other.world_to_camera, atol=1e-6)
    assert "OpenGL's" in " ".join(load_truth(tmp_path / "out").notes)

    file = folder / "output" / "transforms_alignz_train.json"
    data = json.loads(file.read_text())
    first = next(iter(data["frames"].values()))
    turned = np.array(first["transform_matrix"]) @ np.diag([1.0, -1, -1, 1])
    first["transform_matrix"] = turned.tolist()
    file.write_text(json.dumps(data))
    with pytest.raises(InputError, match="1 of 6 cameras look along"):
        convert("open_illumination", folder, tmp_path / "no", Options())


# --- what is wrong ----------------------------------------------------------------------------


def edited(change):
    """A change of a JSON file's contents."""

    def apply(file: Path) -> None:
        data = json.loads(file.read_text())
        change(data)
        file.write_text(json.dumps(data))

    return apply


def remove(file: Path) -> None:
    shutil.rmtree(file) if file.is_dir() else file.unlink()


def smaller(file: Path) -> None:
    """A picture of another shape, without alpha."""
    layout_folders.write_picture(file, read_png(file)[: SIZE // 2])


def cropped(file: Path) -> None:
    """A picture of another shape, with alpha."""
    with Image.open(file) as image:
        image.crop((0, 0, SIZE, SIZE // 2)).save(file)


def renamed(data) -> None:
    """A camera whose name leads out of the folder."""
    data["frames"]["../../x"] = next(iter(data["frames"].values()))


def transparent(file: Path) -> None:
    """A picture that shows nothing."""
    with Image.open(file) as image:
        image.putalpha(0)
        image.save(file)


def speck(file: Path) -> None:
    """A mask of one pixel, all of it rim."""
    mask = np.zeros((SIZE, SIZE), np.uint8)
    mask[20, 20] = 255
    layout_folders.write_picture(file, mask)


def emptied(file: Path) -> None:
    file.write_bytes(b"")


ORB = "../../ground_truth/ball_scene00"
SPOILT = [
    ("nerf_synthetic", "train/r_1.png", emptied, "cannot be read"),
    ("nerf_synthetic", "transforms_test.json", edited(lambda d: d["frames"].clear()), "no frames"),
    ("nerf_synthetic", "transforms_train.json", edited(lambda d: d.pop("camera_angle_x")), "angle"),
    (
        "nerf_synthetic",
        "transforms_train.json",
        edited(lambda d: d["frames"].append(d["frames"][0])),
        "2 of them have it",
    ),
    (
        "nerf_synthetic",
        "transforms_train.json",
        edited(lambda d: d["frames"][0].update(file_path="../../r_0")),
        "outside the scene's folder",
    ),
    ("tensoir", "train_001/rgba_sunset.png", remove, "no picture"),
    ("tensoir", "test_001/rgba_city.png", remove, "no relit picture"),
    ("tensoir", "test_001/rgba_city.png", smaller, "alpha channel"),
    ("tensoir", "test_001/rgba_city.png", cropped, "its view's mask"),
    ("tensoir", "test_001/albedo.png", smaller, "its view 40x40"),
    (
        "tensoir",
        "test_000/metadata.json",
        edited(lambda d: d.update(cam_transform_mat="1,0,0")),
        "16 numbers",
    ),
    ("tensoir", "test_000/metadata.json", edited(lambda d: d.pop("cam_angle_x")), "cam_angle_x"),
    ("tensoir", "../lights/sunset.exr", emptied, "sunset.exr"),
    ("tensoir", "test_001/rgba_sunset.png", transparent, "transparent everywhere"),
    ("stanford_orb", "test_mask/0001.png", speck, "all rim"),
    ("stanford_orb", "test_mask/0001.png", remove, "no mask"),
    ("stanford_orb", "test_mask/0001.png", smaller, "the mask is 40x20"),
    ("stanford_orb", f"{ORB}2/env_map/0001.exr", remove, "no map of this view"),
    ("stanford_orb", "transforms_novel.json", edited(lambda d: d["frames"][0].clear()), "frames.0"),
    (
        "stanford_orb",
        "transforms_novel.json",
        edited(lambda d: d["frames"][0].pop("scene_name")),
        "scene_name",
    ),
    ("stanford_orb", "transforms_test.json", edited(lambda d: d["frames"].clear()), "no frames"),
    ("open_illumination", "Lights", remove, "no folder Lights"),
    ("open_illumination", "Lights/013", remove, "no pattern 013"),
    ("open_illumination", "output/obj_masks", remove, "no mask"),
    ("open_illumination", "output/transforms_alignz_test.json", remove, "are not together"),
    ("open_illumination", "output/transforms_alignz_test.json", edited(dict.clear), "frames"),
    ("open_illumination", "output/transforms_alignz_test.json", edited(renamed), "no mask"),
]


@pytest.mark.parametrize(
    "layout, file, spoil, said", SPOILT, ids=[f"{s[0]}-{s[1]}-{k}" for k, s in enumerate(SPOILT)]
)
def test_what_is_wrong_is_named(layout, file, spoil, said, own_copy, tmp_path):
    """What, where and what to do; nothing is left behind."""
    folder = own_copy(layout)
    spoil(folder / file)
    out = tmp_path / "out"
    with pytest.raises(InputError, match=said) as caught:
        convert(layout, folder, out, options_for(layout, folder))
        load_truth(out)
    assert caught.value.where and caught.value.cure
    assert out.exists() == (spoil in (cropped, speck))  # that is seen when it is scored
