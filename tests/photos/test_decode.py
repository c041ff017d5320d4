"""Photos as cameras and programs write them, each read from a real file."""

import cv2
import numpy as np
import pytest
import tifffile
from PIL import Image

from pipeline.base.config import Capture
from pipeline.base.errors import InputError
from pipeline.base.images import srgb_to_linear
from pipeline.photos.capture import convert
from pipeline.photos.decode import EXIF_IFD, _exif_facts, decode
from tests.photos.files import (
    ADOBE_PROFILE,
    DATA,
    P3_PROFILE,
    PICTURE,
    STORED,
    exif_of,
    icc_profile,
    srgb_curve,
)


def linear(path, **settings) -> np.ndarray:
    return convert(path.parent, path, Capture(**settings)).linear


@pytest.mark.parametrize("orientation", range(9))
@pytest.mark.parametrize("kind", ["jpg", "png", "tif", "deep.png", "deep.tif"])
def test_every_orientation_of_every_format_is_undone(tmp_path, orientation, kind):
    stored = np.ascontiguousarray(STORED[orientation](PICTURE))
    path = tmp_path / f"photo.{kind}"
    if kind == "deep.tif":
        tags = [(274, "H", 1, orientation, True)]
        deep = stored.astype(np.uint16) * 257
        tifffile.imwrite(path, deep, photometric="rgb", extratags=tags)
    elif kind == "deep.png":
        add_exif_to_deep_png(path, stored, orientation)
    else:
        options = {"quality": 98, "subsampling": 0} if kind == "jpg" else {}
        Image.fromarray(stored).save(path, exif=exif_of(orientation), **options)

    photo = decode(path)
    assert photo.pixels.dtype == (np.uint16 if "deep" in kind else np.uint8)
    assert photo.pixels.shape == PICTURE.shape
    quarters = np.round(photo.pixels[12::24, 16::32] / photo.full_scale * 255)
    np.testing.assert_allclose(quarters, PICTURE[12::24, 16::32], atol=3 if kind == "jpg" else 0)


def add_exif_to_deep_png(path, stored, orientation) -> None:
    """A PNG of 16 bits by OpenCV, with the chunk eXIf behind its header."""
    import struct
    import zlib

    deep = (stored[..., ::-1].astype(np.uint16) * 257).copy()
    data = cv2.imencode(".png", deep)[1].tobytes()
    exif = exif_of(orientation).tobytes().removeprefix(b"Exif\0\0")
    chunk = b"eXIf" + exif
    chunk = struct.pack(">I", len(exif)) + chunk + struct.pack(">I", zlib.crc32(chunk))
    path.write_bytes(data[:33] + chunk + data[33:])


# --- HEIC -------------------------------------------------------------------------------------


def test_heic_is_read_with_its_exif():
    photo = decode(DATA / "plain.heic")
    np.testing.assert_allclose(photo.pixels[12::24, 16::32], PICTURE[12::24, 16::32], atol=3)
    assert (
        photo.facts["time"] == 0.01 and photo.facts["f_number"] == 4 and "note" not in photo.facts
    )


def test_heic_is_turned_once():
    """The container says how the picture is turned, and its EXIF (6) says so again."""
    photo = decode(DATA / "turned.heic")
    np.testing.assert_allclose(photo.pixels[12::24, 16::32], PICTURE[12::24, 16::32], atol=3)


def test_heic_that_asks_for_more_than_libheif_allows_is_named(tmp_path):
    data = bytearray((DATA / "plain.heic").read_bytes())
    extents = data.find(b"iloc") + 20  # of the first item
    data[extents : extents + 2] = b"\x03\x04"
    (tmp_path / "a.heic").write_bytes(data)
    with pytest.raises(InputError, match="a.heic.*cannot be read.*limit"):
        decode(tmp_path / "a.heic")


def test_ten_bits_of_heic_are_kept():
    photo = decode(DATA / "ten_bit.heic")
    values = np.unique(photo.pixels[24, :, 1])
    assert photo.pixels.dtype == np.uint16 and photo.facts["note"] == "10 bit"
    assert len(values) > 60 and (values % 256 != 0).any()
    np.testing.assert_allclose(
        photo.pixels[24, :, 1] / 65535, np.linspace(0, 1, 64), atol=0.01
    )  # quality 95


def test_display_p3_of_heic_is_converted_as_its_profile_would_be(tmp_path):
    Image.fromarray(decode(DATA / "display_p3.heic").pixels).save(
        tmp_path / "same.png", icc_profile=P3_PROFILE
    )
    by_points = linear(DATA / "display_p3.heic")
    np.testing.assert_allclose(by_points, linear(tmp_path / "same.png"), atol=2e-3)
    assert by_points[12, 16, 0] > srgb_to_linear(np.array(200 / 255)) * 1.05  # redder than sRGB


def test_hdr_curves_are_refused_with_the_reason():
    with pytest.raises(InputError, match=r"hdr_pq.heic.*colour primaries|PQ"):
        decode(DATA / "hdr_pq.heic")
    assert decode(DATA / "hdr_pq.heic", profiles=False).pixels.shape == PICTURE.shape


def test_truncated_heic_is_named(tmp_path):
    data = (DATA / "plain.heic").read_bytes()
    (tmp_path / "cut.heic").write_bytes(data[: len(data) // 2])
    with pytest.raises(InputError, match="cut.heic.*cannot be read"):
        decode(tmp_path / "cut.heic")


# --- colour profiles --------------------------------------------------------------------------


@pytest.mark.parametrize("profile", [ADOBE_PROFILE, P3_PROFILE])
@pytest.mark.parametrize("kind", ["jpg", "png", "tif"])
def test_profiles_agree_with_little_cms(tmp_path, profile, kind):
    """Against Pillow's colour engine, on colours inside of sRGB, where it does not clip."""
    from io import BytesIO

    from PIL import ImageCms

    soft = (100 + 0.3 * PICTURE).astype(np.uint8)
    path = tmp_path / f"photo.{kind}"
    options = {"quality": 100, "subsampling": 0} if kind == "jpg" else {}
    Image.fromarray(soft).save(path, icc_profile=profile, **options)
    source = ImageCms.ImageCmsProfile(BytesIO(profile))
    expected = ImageCms.profileToProfile(Image.open(path), source, ImageCms.createProfile("sRGB"))

    ours = linear(path)
    theirs = srgb_to_linear(np.asarray(expected) / 255)
    np.testing.assert_allclose(ours, theirs, atol=0.006)  # a step of 8 bits at .5 linear
    plain = srgb_to_linear(np.asarray(Image.open(path)) / 255)
    assert np.abs(ours - plain).max() > 0.02  # the profile counts


def test_sixteen_bits_with_a_profile_stay_sixteen_bits(tmp_path):
    ramp = np.repeat(np.linspace(0, 65535, 64)[None, :, None].astype(np.uint16), 16, 0)
    grey = np.repeat(ramp, 3, 2)
    tifffile.imwrite(tmp_path / "a.tif", grey, photometric="rgb", iccprofile=ADOBE_PROFILE)
    expected = (grey / 65535.0) ** (563 / 256)
    np.testing.assert_allclose(linear(tmp_path / "a.tif"), expected, atol=5e-4)


def test_colours_outside_of_srgb_are_kept_above_one(tmp_path):
    red = np.zeros((8, 8, 3), np.uint8)
    red[..., 0] = 240
    Image.fromarray(red).save(tmp_path / "red.png", icc_profile=P3_PROFILE)
    found = convert(tmp_path, tmp_path / "red.png", Capture())
    light = float(srgb_to_linear(np.array(240 / 255)))
    np.testing.assert_allclose(found.linear[4, 4], [1.2249 * light, 0, 0], atol=2e-3)
    assert not found.saturated.any()  # above 1, but its own channel is not at full scale


def test_adobe_rgb_marked_in_exif_only(tmp_path):
    exif = Image.Exif()
    exif.get_ifd(0x8769)[0xA001] = 65535
    exif.get_ifd(0x8769)[0xA005] = {1: "R03"}
    options = {"quality": 100, "subsampling": 0}
    Image.fromarray(PICTURE).save(tmp_path / "marked.jpg", exif=exif, **options)
    Image.fromarray(PICTURE).save(tmp_path / "icc.jpg", icc_profile=ADOBE_PROFILE, **options)
    np.testing.assert_allclose(
        linear(tmp_path / "marked.jpg"), linear(tmp_path / "icc.jpg"), atol=2e-3
    )


def test_srgb_profile_changes_nothing_and_profiles_can_be_ignored(tmp_path):
    from PIL import ImageCms

    srgb = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    Image.fromarray(PICTURE).save(tmp_path / "srgb.png", icc_profile=srgb)
    Image.fromarray(PICTURE).save(tmp_path / "p3.png", icc_profile=P3_PROFILE)
    plain = srgb_to_linear(PICTURE / 255)
    np.testing.assert_array_equal(linear(tmp_path / "srgb.png"), plain)
    np.testing.assert_array_equal(linear(tmp_path / "p3.png", encoding="srgb"), plain)
    np.testing.assert_allclose(
        linear(tmp_path / "p3.png", encoding="linear"), PICTURE / 255, atol=1e-6
    )


def test_damaged_profile_is_named(tmp_path):
    broken = icc_profile(((0, 0, 0),) * 3, srgb_curve()).replace(b"rTRC", b"xTRC")
    deep = np.zeros((8, 8, 3), np.uint16)
    tifffile.imwrite(tmp_path / "a.tif", deep, photometric="rgb", iccprofile=broken)
    with pytest.raises(InputError, match="a.tif.*colours cannot be converted"):
        decode(tmp_path / "a.tif")


@pytest.mark.parametrize("value", [1e200, float("inf"), float("nan"), -4.0, 0.0])
def test_impossible_numbers_of_exif_are_none(value):
    exif = Image.Exif()
    exif.get_ifd(EXIF_IFD).update({0x829D: value, 0x829A: 0.01})
    facts = _exif_facts(exif)
    assert facts["time"] == 0.01 and "f_number" not in facts


def test_a_profile_without_a_white_is_damaged(tmp_path):
    """As a flipped bit leaves it: radiance would be ten thousand times too bright."""
    wild = np.array([[3e4, 2e4, 1e4], [1.0, 2.0, 3.0], [-2e4, 1e4, 5.0]])
    path = tmp_path / "p.png"
    Image.fromarray(PICTURE).save(path, icc_profile=icc_profile(wild, srgb_curve()))
    with pytest.raises(InputError, match="its profile is damaged: white is"):
        decode(path)
    assert decode(path, profiles=False).space.is_srgb()


def test_a_heif_without_a_picture_is_refused(monkeypatch):
    import pi_heif

    class Nothing:
        @property
        def __array_interface__(self):
            return [][0]

    monkeypatch.setattr(pi_heif, "open_heif", lambda data, convert_hdr_to_8bit: Nothing())
    with pytest.raises(InputError, match="plain.heic.*holds no picture"):
        decode(DATA / "plain.heic")
