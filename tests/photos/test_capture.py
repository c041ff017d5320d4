import json
import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import OpenEXR
import pytest
from PIL import Image

from pipeline.base.config import Capture
from pipeline.base.errors import InputError
from pipeline.base.files import read_json
from pipeline.base.images import (
    LARGEST_HALF,
    linear_to_srgb,
    luminance,
    read_exr,
    read_png,
    srgb_to_linear,
    write_exr,
)
from pipeline.photos.capture import capture
from pipeline.photos.decode import decode
from pipeline.photos.given_cameras import read_transforms
from pipeline.photos.radiance import Radiance
from pipeline.photos.scene_files import find_photos, left_out
from tests.seeds import numpy_rng

PHOTO = (numpy_rng(0).random((24, 36, 3)) * 255).astype(np.uint8)


@pytest.fixture
def scene(tmp_path):
    folder = tmp_path / "schöner Garten 1"
    (folder / "images").mkdir(parents=True)
    for k in range(4):
        Image.fromarray(PHOTO).save(folder / "images" / f"bild {k} ä.png")
    return folder


def run(scene, tmp_path, **settings):
    """Capture with every photo kept: those of these tests show one and the same noise."""
    settings = {"leave_out": "none"} | settings
    out = tmp_path / "out"
    out.mkdir()
    metrics = capture(scene, out, Capture(**settings))
    return out, metrics, json.loads((out / "photos.json").read_text(encoding="utf-8"))["photos"]


def test_srgb_curve_is_inverted():
    x = np.linspace(0, 1, 256, dtype=np.float32)
    assert np.allclose(linear_to_srgb(srgb_to_linear(x)), x, atol=1e-5)
    assert np.isclose(srgb_to_linear(np.array(0.5)), 0.21404, atol=1e-4)


def test_eight_bit_photos_become_linear(scene, tmp_path):
    out, metrics, photos = run(scene, tmp_path)
    assert metrics["photos"] == 4
    assert np.allclose(
        read_exr(out / "images" / "bild 2 ä.exr"), srgb_to_linear(PHOTO / 255.0), atol=1e-3
    )


def test_every_kind_of_file_shows_the_same_picture(scene, tmp_path):
    """CMYK, 16 bit, EXIF-rotated and EXR copies all decode to the upright original."""
    images = scene / "images"
    smooth = np.broadcast_to(np.linspace(30, 220, 36)[None, :, None], (24, 36, 3)).astype(np.uint8)
    Image.fromarray(smooth).convert("CMYK").save(images / "cmyk.jpg", quality=100)
    cv2.imwrite(str(images / "deep.png"), (smooth[..., ::-1].astype(np.uint16) * 257))
    exif = Image.Exif()
    exif[0x0112] = 6  # stored turned: rotate 90 degrees clockwise to show
    Image.fromarray(np.rot90(smooth)).save(images / "turned.png", exif=exif)
    write_exr(images / "linear.exr", srgb_to_linear(smooth / 255.0))
    out, _, photos = run(scene, tmp_path)
    expected = srgb_to_linear(smooth / 255.0)
    for name, tolerance in (("cmyk", 0.03), ("deep", 1e-3), ("turned", 1e-3), ("linear", 1e-3)):
        assert np.allclose(read_exr(out / "images" / f"{name}.exr"), expected, atol=tolerance), name


def test_mixed_sizes_are_resized_each(scene, tmp_path):
    Image.fromarray(np.zeros((50, 80, 3), np.uint8)).save(scene / "images" / "big.png")
    _, metrics, photos = run(scene, tmp_path, max_size=64)
    assert {(p["width"], p["height"]) for p in photos} == {(36, 24), (64, 40)}


def test_alpha_becomes_a_mask_and_does_not_darken_edges(tmp_path):
    folder = tmp_path / "s"
    (folder / "images").mkdir(parents=True)
    rgba = np.full((32, 32, 4), 200, np.uint8)
    rgba[..., 3] = 0
    rgba[7:25, 7:25, 3] = 255
    rgba[rgba[..., 3] == 0, :3] = 0
    for k in range(3):
        Image.fromarray(rgba).save(folder / "images" / f"{k}.png")
    out = tmp_path / "out"
    out.mkdir()
    assert capture(folder, out, Capture(max_size=64, leave_out="none"))["masks"] == 3
    mask = np.asarray(Image.open(out / "masks" / "0.png")) > 0
    assert mask.sum() == 18 * 18
    assert np.allclose(
        read_exr(out / "images" / "0.exr")[mask], srgb_to_linear(np.array(200 / 255)), atol=2e-3
    )


def test_exposure_is_divided_out(scene, tmp_path):
    for k, seconds in enumerate((0.01, 0.02, 0.01, 0.01)):
        exif = Image.Exif()
        ifd = exif.get_ifd(0x8769)
        ifd[0x829A], ifd[0x829D], ifd[0x8827] = seconds, 4.0, 100
        (scene / "images" / f"bild {k} ä.png").unlink()
        Image.fromarray(PHOTO).save(
            scene / "images" / f"p{k}.jpg", quality=100, subsampling=0, exif=exif
        )
    out, metrics, photos = run(scene, tmp_path)
    a, b = (read_exr(out / "images" / f"p{k}.exr") for k in (0, 1))
    assert np.allclose(a, 2 * b, rtol=0.01, atol=1e-3) and "2.00" in metrics["exposure"]
    assert abs(np.log([p["gain"] for p in photos]).sum()) < 1e-12
    assert read_json(out / "photos.json")["exposure_known"]


def test_without_exif_no_exposure_is_known(scene, tmp_path):
    out, metrics, _ = run(scene, tmp_path)
    assert metrics["exposure"] == "no EXIF exposure"
    assert not read_json(out / "photos.json")["exposure_known"]


@pytest.mark.parametrize(
    "break_it, fact",
    [
        (lambda s: [p.unlink() for p in (s / "images").iterdir()], "no photos"),
        (lambda s: [p.unlink() for p in sorted((s / "images").iterdir())[2:]], "at least 3"),
        (
            lambda s: (s / "images" / "cut.jpg").write_bytes(_jpeg()[: len(_jpeg()) // 2]),
            "cut.jpg.*cannot be read",
        ),
        (lambda s: _mask(s, np.full((10, 10), 255, np.uint8)), "10x10"),
        (lambda s: _mask(s, np.zeros((24, 36), np.uint8)), "all black"),
        (lambda s: _mask_of_trillions(s), "2000000x2000000, its photo"),
        (lambda s: Image.fromarray(PHOTO).save(s / "images" / "bild 1 ä.jpg"), "two photos"),
        (
            lambda s: (s / "transforms.json").write_text(
                json.dumps({"frames": [{"file_path": "images/none.png"}] * 3})
            ),
            "not there",
        ),
    ],
)
def test_bad_input_is_named(scene, tmp_path, break_it, fact):
    break_it(scene)
    with pytest.raises(InputError, match=fact):
        run(scene, tmp_path)


def _jpeg() -> bytes:
    import io

    buffer = io.BytesIO()
    Image.fromarray(PHOTO).save(buffer, "JPEG")
    return buffer.getvalue()


def _mask(scene, mask):
    (scene / "masks").mkdir()
    Image.fromarray(mask).save(scene / "masks" / "bild 1 ä.png")


def _mask_of_trillions(scene):
    """Its head claims 2 000 000 pixels along both sides."""
    _mask(scene, np.full((24, 36), 255, np.uint8))
    file = scene / "masks" / "bild 1 ä.png"
    data = bytearray(file.read_bytes())
    data[16:24] = struct.pack(">II", 2_000_000, 2_000_000)
    data[29:33] = struct.pack(">I", zlib.crc32(bytes(data[12:29])))
    file.write_bytes(data)


def test_hidden_and_mask_files_are_no_photos(scene):
    (scene / "images" / ".hidden.png").write_bytes(b"x")
    for folder in (scene / "images" / ".thumbnails", scene / "images" / "b" / ".cache" / "large"):
        folder.mkdir(parents=True)
        Image.fromarray(PHOTO).save(folder / "bild.png")
        (folder / "bild.webp").write_bytes(b"x")
    found = find_photos(scene)
    assert len(found) == 4 and left_out(scene, found) == {}


def test_a_mask_is_of_one_photo(scene, tmp_path):
    """Photos of one stem in two folders: by stem alone one mask would be both photos'."""
    masks = scene / "masks"
    masks.mkdir()
    white = Image.fromarray(np.full(PHOTO.shape[:2], 255, np.uint8))
    white.save(masks / "0001.png")
    for side in ("left", "right"):
        (scene / "images" / side).mkdir()
        Image.fromarray(PHOTO).save(scene / "images" / side / "0001.jpg")
    with pytest.raises(InputError, match="may be the mask of .*left/0001.jpg and of .*right/0001"):
        run(scene, tmp_path)

    (masks / "left").mkdir()
    (masks / "0001.png").rename(masks / "left" / "0001.png")
    (tmp_path / "out").rmdir()
    photos = {p["name"]: p["has_mask"] for p in run(scene, tmp_path)[2]}
    assert photos["left_0001"] and not photos["right_0001"]


def test_dots_in_names_stay_apart_and_unnamed_photos_are_told(scene, tmp_path, capsys):
    """`file_path` without suffix but with a dot; photos no frame names are recorded, not used."""
    for k in range(3):
        Image.fromarray(PHOTO).save(scene / "images" / f"frame.{k}.png")
    frames = [
        {"file_path": f"images/frame.{k}", "transform_matrix": np.eye(4).tolist()} for k in range(3)
    ]
    (scene / "transforms.json").write_text(json.dumps({"camera_angle_x": 1.0, "frames": frames}))
    out, metrics, photos = run(scene, tmp_path)
    assert [p["name"] for p in photos] == ["frame.0", "frame.1", "frame.2"]
    assert metrics["left_out"] == 4
    assert all((out / "images" / f"{p['name']}.exr").exists() for p in photos)
    assert "bild 0" in capsys.readouterr().err


def test_sixteen_bit_tiff_and_grey(scene, tmp_path):
    ramp = np.broadcast_to(np.linspace(0, 65535, 36)[None], (24, 36)).astype(np.uint16)
    cv2.imwrite(str(scene / "images" / "deep.tif"), np.stack([ramp] * 3, -1))
    cv2.imwrite(str(scene / "images" / "grey.png"), ramp)
    out, _, _ = run(scene, tmp_path)
    for name in ("deep", "grey"):
        assert np.allclose(
            read_exr(out / "images" / f"{name}.exr")[..., 1],
            srgb_to_linear(ramp / 65535.0),
            atol=1e-3,
        ), name


@pytest.mark.parametrize(
    "name, save, fact",
    [
        (
            "float.tif",
            lambda p: Image.fromarray(np.ones((8, 8), np.float32)).save(p),
            "32 bits per channel",
        ),
        ("text.png", lambda p: p.write_text("no picture"), "cannot be read"),
    ],
)
def test_unusable_photo_is_named(scene, tmp_path, name, save, fact):
    save(scene / "images" / name)
    with pytest.raises(InputError, match=f"{name}.*{fact}"):
        run(scene, tmp_path)


def test_broken_mask_is_named(scene, tmp_path):
    (scene / "masks").mkdir()
    (scene / "masks" / "bild 1 ä.png").write_bytes(b"no picture")
    with pytest.raises(InputError, match="bild 1.*mask cannot be read"):
        run(scene, tmp_path)


def test_focal_guess_and_its_source():
    from pipeline.photos.capture import focal_guess

    assert focal_guess({"width": 720, "height": 360, "focal_35mm": 50.0})[
        "focal_px"
    ] == pytest.approx(1000)
    assert "assumed" in focal_guess({"width": 100, "height": 200})["focal_source"]


# --- names in transforms.json -----------------------------------------------------------------


def name_photos(scene, paths) -> None:
    """A transforms.json whose frames name `paths`."""
    frames = [{"file_path": str(p), "transform_matrix": np.eye(4).tolist()} for p in paths]
    (scene / "transforms.json").write_text(json.dumps({"camera_angle_x": 1.0, "frames": frames}))


@pytest.mark.parametrize(
    "path",
    [
        "../secret.png",
        "images/../../secret.png",
        "./images/./../../secret",
        "{outside}/secret.png",
        "/etc/passwd",
        "..",
        ".",
        "",
    ],
)
def test_names_that_leave_the_scene_are_refused(scene, tmp_path, path):
    Image.fromarray(PHOTO).save(tmp_path / "secret.png")
    path = path.format(outside=tmp_path)
    name_photos(scene, [path, *(scene / "images").iterdir()])
    with pytest.raises(InputError, match="transforms.json.*outside the scene's folder"):
        run(scene, tmp_path)
    with pytest.raises(InputError, match="transforms.json.*outside the scene's folder"):
        read_transforms(scene / "transforms.json", scene, {})


def test_a_folder_whose_name_begins_like_the_scenes_is_outside(scene, tmp_path):
    other = tmp_path / f"{scene.name} other"
    other.mkdir()
    Image.fromarray(PHOTO).save(other / "a.png")
    name_photos(scene, [f"../{other.name}/a.png"] * 3)
    with pytest.raises(InputError, match="outside the scene's folder"):
        find_photos(scene)


def test_ways_around_within_the_scene_and_absolute_names_work(scene, monkeypatch):
    own = [f"bild {k} ä.png" for k in range(4)]
    names = [
        f"images/../images/{own[0]}",
        scene / "images" / own[1],
        f"./images/{own[2]}",
        f"images/{own[3]}",
    ]
    name_photos(scene, names)
    expected = [(f"bild {k} ä", scene / "images" / own[k], "fit") for k in range(4)]
    assert find_photos(scene) == expected

    monkeypatch.chdir(scene.parent)  # the configuration may name the scene by a relative path
    assert [name for name, _, _ in find_photos(Path(scene.name))] == [n for n, _, _ in expected]


@pytest.mark.parametrize("linked", ["images", "scene"])
def test_symbolic_links_of_the_users_own_work(scene, tmp_path, linked):
    """images/ on another disk, or the scene itself, and cameras that name photos by real paths."""
    if linked == "images":
        (scene / "images").rename(tmp_path / "disk")
        (scene / "images").symlink_to(tmp_path / "disk")
        photos = [f"images/{p.name}" for p in (scene / "images").iterdir()]
        link = scene
    else:
        link = tmp_path / "link"
        link.symlink_to(scene)
        photos = [p.resolve() for p in (scene / "images").iterdir()]
    assert len(find_photos(link)) == 4

    name_photos(scene, photos)
    _, metrics, _ = run(link, tmp_path)
    assert metrics["photos"] == 4 and metrics["left_out"] == 0


# --- saturation, before scaling ---------------------------------------------------------------


def test_saturation_is_judged_before_scaling(scene, tmp_path):
    """Single saturated pixels of a photo that is scaled by 4 leave no trace in the mean's level;
    grey just below the clip level is not saturated however much of it there is.
    """
    photo = np.full((96, 128, 3), 100, np.uint8)
    photo[8, 40] = 255  # one pixel, all channels
    photo[50, 100, 2] = 255  # one pixel, one channel
    photo[60:, :60] = 250  # .980 of full scale
    for k in range(4):
        Image.fromarray(photo).save(scene / "images" / f"bild {k} ä.png")
    out, metrics, photos = run(scene, tmp_path, max_size=64)
    out_saturated = np.asarray(Image.open(out / "saturated" / "bild 1 ä.png")) > 0
    assert np.argwhere(out_saturated).tolist() == [[4, 20, 0], [4, 20, 1], [4, 20, 2], [25, 50, 2]]
    assert read_exr(out / "images" / "bild 1 ä.exr")[4, 20].max() < 0.4
    assert metrics["clipped_share"] == pytest.approx(2 / (48 * 64))


def exr(file: Path, channels: dict[str, np.ndarray]) -> Path:
    """An EXR file of any channels."""
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    with OpenEXR.File(header, channels) as picture:
        picture.write(str(file))
    return file


def test_alpha_of_an_exr_is_a_mask(scene, tmp_path):
    pixels = np.full((24, 36, 4), 0.4, np.float32)
    pixels[..., 3] = 0
    pixels[4:20, 6:30, 3] = 1
    exr(scene / "images" / "linear.exr", {"RGBA": pixels})
    out, _, photos = run(scene, tmp_path)
    assert [p["name"] for p in photos if p["has_mask"]] == ["linear"]
    assert ((read_png(out / "masks" / "linear.png") > 127) == (pixels[..., 3] > 0)).all()


def test_no_other_layer_of_an_exr_is_taken_for_the_photo(scene, tmp_path):
    depth = np.full((24, 36), 7.0, np.float32)
    color = np.full((24, 36, 3), 0.4, np.float32)
    file = exr(
        scene / "images" / "a.exr", {"depth.Z": depth, "RGB": color, "glossy.RGB": 2 * color}
    )
    out, _, _ = run(scene, tmp_path)
    assert np.allclose(read_exr(out / "images" / "a.exr"), 0.4, atol=1e-3)

    exr(file, {"depth.Z": depth, "beauty.RGB": color})
    with pytest.raises(InputError, match="beauty.* not R, G, B"):
        decode(file)
    with pytest.raises(InputError, match="neither R, G, B nor a single one"):
        read_exr(file)


def exr_scene(folder: Path, unit: float) -> Path:
    """Three linear photos of one thing, from other sides, in a unit of radiance."""
    (folder / "images").mkdir(parents=True)
    for k in range(3):
        pixels = np.roll(srgb_to_linear(PHOTO / 255.0), 5 * k, 1)
        write_exr(folder / "images" / f"{k}.exr", unit * pixels)
    return folder


@pytest.mark.parametrize("unit", [2.0**-9, 0.5, 1.0, 2.0**5, 2.0**20])
def test_photos_in_any_unit_of_radiance_show_the_same(tmp_path, unit):
    """To the bit, for a unit that is a power of two; the unit itself is written down."""
    out, metrics, photos = run(exr_scene(tmp_path / "any", unit), tmp_path)
    white = Radiance.load(out).white
    assert white == metrics["white"] and (unit not in (0.5, 1.0) or white == 1.0)
    for k in range(3):
        mine = read_exr(out / "images" / f"{k}.exr")
        expected = np.roll(srgb_to_linear(PHOTO / 255.0), 5 * k, 1) * (unit / white)
        assert np.array_equal(mine, expected.astype(np.float16).astype(np.float32))
        assert 0.1 < np.percentile(luminance(mine), 95) < 2
    assert all(p["clip_level"] == 1e6 for p in photos)


def test_integers_bring_their_unit_along(scene, tmp_path):
    for k in range(4):
        Image.fromarray(PHOTO // 16).save(scene / "images" / f"bild {k} ä.png")
    out, _, _ = run(scene, tmp_path)
    assert Radiance.load(out).white == 1.0


def test_a_pixel_that_no_half_can_hold_is_a_lower_bound(scene, tmp_path):
    pixels = np.full((24, 36, 3), 0.4, np.float32)
    pixels[3, 5] = 1e6, 0.5, 7e4
    write_exr(scene / "images" / "sun.exr", pixels)
    out, _, _ = run(scene, tmp_path)
    assert read_exr(out / "images" / "sun.exr")[3, 5, 0] == LARGEST_HALF
    saturated = read_png(out / "saturated" / "sun.png") > 0
    assert saturated.sum() == 2 and saturated[3, 5].tolist() == [True, False, True]


def test_scaling_averages_light_and_not_codes(scene, tmp_path):
    stripes = np.zeros((96, 128, 3), np.uint8)
    stripes[:, ::2] = 200
    for k in range(4):
        Image.fromarray(stripes).save(scene / "images" / f"bild {k} ä.png")
    out, _, _ = run(scene, tmp_path, max_size=64)
    np.testing.assert_allclose(
        read_exr(out / "images" / "bild 0 ä.exr"),
        0.5 * srgb_to_linear(np.array(200 / 255)),
        rtol=2e-3,
    )


# --- files that are not used ------------------------------------------------------------------


def test_files_that_are_left_out_are_named(scene, tmp_path, capsys):
    from tests.photos.files import DATA

    images = scene / "images"
    for name in ("a.dng", "b.mov", "c.webp", "notes.txt"):
        (images / name).write_bytes(b"x")
    (images / "d.HEIC").write_bytes((DATA / "plain.heic").read_bytes())
    (scene / "masks").mkdir()
    Image.fromarray(np.full((24, 36), 255, np.uint8)).save(scene / "masks" / "bild_1.png")
    out, metrics, photos = run(scene, tmp_path)
    told = capsys.readouterr().err
    assert [p["name"] for p in photos if p["file"].endswith(".HEIC")] == ["d"]
    for name, reason in (
        ("images/a.dng", "raw file"),
        ("images/b.mov", "video"),
        ("images/c.webp", "format that is not read"),
        ("masks/bild_1.png", "matches no photo"),
    ):
        assert any(name in text and reason in text for text in metrics["warnings"]), name
        assert name in told
    assert metrics["left_out"] == 4 and "notes.txt" not in told


def test_masks_may_be_called_by_the_photos_full_name(scene, tmp_path):
    (scene / "masks").mkdir()
    for k in range(4):
        mask = Image.fromarray(np.full((24, 36), 255, np.uint8))
        mask.save(scene / "masks" / f"bild {k} ä.png.png")
    assert run(scene, tmp_path)[1]["masks"] == 4


def test_masks_of_some_photos_are_taken_as_they_are(scene, tmp_path):
    _mask(scene, np.full((24, 36), 255, np.uint8))
    out, metrics, photos = run(scene, tmp_path)
    assert metrics["masks"] == 1 and sum(p["has_mask"] for p in photos) == 1
    assert len(list((out / "masks").iterdir())) == 1
