"""Cases of photos: damaged, tiny, huge, and in every dress that a file may come in."""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import OpenEXR
from PIL import Image, ImageCms, ImageFilter
from PIL.TiffImagePlugin import IFDRational

from benchmarks.corpus.case import message, result
from benchmarks.corpus.project import HEIGHT, WIDTH, Project, picture
from pipeline.base.files import read_json
from pipeline.base.images import read_exr, to_srgb8

GROUP = "photo"
TO_POSES = ("capture", "poses")
HEIC = Path(__file__).resolve().parents[2] / "tests" / "photos" / "data" / "plain.heic"
EXIF_IFD = 0x8769
ORIENTATION = 0x0112


def eight_bit(number: int = 0) -> Image.Image:
    """A view as its photo."""
    return Image.fromarray(to_srgb8(picture(number)[0]))


def jpeg(number: int = 0, **options) -> bytes:
    buffer = io.BytesIO()
    eight_bit(number).save(buffer, "JPEG", **{"quality": 95, "subsampling": 0} | options)
    return buffer.getvalue()


def instead(project: Project, name: str, data: bytes | None = None):
    """Another file in place of the first photo, whose frame names it; its path."""
    (project.images / "p0.png").unlink()
    (project.masks / "p0.png").rename(project.masks / f"{name.rsplit('.', 1)[0]}.png")
    cameras = project.cameras()
    cameras["frames"][0]["file_path"] = f"images/{name}"
    project.write_cameras(cameras)
    path = project.images / name
    if data is not None:
        path.write_bytes(data)
    return path


def shows_the_view(name: str = "p0", tolerance: float = 0.02, number: int = 0) -> Callable:
    """Check that the captured photo `name` is the linear picture of a view."""

    def check(project: Project) -> None:
        found = read_exr(project.work / "capture" / "images" / f"{name}.exr")
        expected = picture(number)[0]
        assert found.shape == expected.shape, f"{found.shape} for {expected.shape}"
        error = float(np.abs(found - expected).mean())
        assert error < tolerance, f"mean error of the linear photo {error:.3f}"

    return check


right = shows_the_view()


@message(GROUP, "JPEG cut in the middle", "p0.jpg", "cannot be read", "copy it again")
def cut_jpeg(p: Project) -> None:
    instead(p, "p0.jpg", jpeg()[: len(jpeg()) // 2])


@message(GROUP, "JPEG with noise for its second half", "p0.jpg")
def noisy_jpeg(p: Project) -> None:
    data = bytearray(jpeg())
    data[30:600] = np.random.default_rng(0).bytes(570)
    instead(p, "p0.jpg", bytes(data))


@result(GROUP, "JPEG with rubbish after its end", right)
def long_jpeg(p: Project) -> None:
    instead(p, "p0.jpg", jpeg() + b"rubbish" * 100)


@result(GROUP, "progressive JPEG", right)
def progressive(p: Project) -> None:
    instead(p, "p0.jpg", jpeg(progressive=True))


@message(GROUP, "zero bytes", "p0.jpg", "empty")
def zero_bytes(p: Project) -> None:
    instead(p, "p0.jpg", b"")


@message(GROUP, "PNG cut in the middle", "p0.png", "cannot be read")
def cut_png(p: Project) -> None:
    data = (p.images / "p0.png").read_bytes()
    (p.images / "p0.png").write_bytes(data[: len(data) // 2])


@message(GROUP, "PNG whose checksum is wrong", "p0.png", "cannot be read")
def wrong_checksum(p: Project) -> None:
    data = bytearray((p.images / "p0.png").read_bytes())
    data[len(data) // 2] ^= 0xFF
    (p.images / "p0.png").write_bytes(bytes(data))


@message(GROUP, "PNG that claims 2 000 000 x 2 000 000 pixels", "p0.png", "pixels")
def bomb(p: Project) -> None:
    data = bytearray((p.images / "p0.png").read_bytes())
    data[16:24] = struct.pack(">II", 2_000_000, 2_000_000)
    data[29:33] = struct.pack(">I", zlib.crc32(bytes(data[12:29])))
    (p.images / "p0.png").write_bytes(bytes(data))


@message(GROUP, "one pixel", "p0.png", "1x1", "at least")
def one_pixel(p: Project) -> None:
    eight_bit().resize((1, 1)).save(p.images / "p0.png")
    (p.masks / "p0.png").unlink()


@message(GROUP, "a strip of one row", "p0.png", f"{WIDTH}x1", "at least")
def one_row(p: Project) -> None:
    eight_bit().resize((WIDTH, 1)).save(p.images / "p0.png")
    (p.masks / "p0.png").unlink()


def huge(p: Project, side: int) -> None:
    """The first photo with `side` pixels along its long side, and its mask."""
    size = (side, round(side * HEIGHT / WIDTH))
    eight_bit().resize(size, Image.Resampling.NEAREST).save(p.images / "p0.png", compress_level=1)
    with Image.open(p.masks / "p0.png") as image:
        mask = image.resize(size, Image.Resampling.NEAREST)
    mask.save(p.masks / "p0.png", compress_level=1)
    p.settings["capture"] = {"max_size": WIDTH}
    p.write_config()


@result(GROUP, "12 000 pixels wide", right, heavy=True, timeout=180)
def wide(p: Project) -> None:
    huge(p, 12_000)


@message(GROUP, "20 000 pixels wide", "p0.png", "20000x15556", "at most", heavy=True, timeout=180)
def wider(p: Project) -> None:
    huge(p, 20_000)


@result(GROUP, "CMYK JPEG without a profile", shows_the_view(tolerance=0.05))
def cmyk(p: Project) -> None:
    eight_bit().convert("CMYK").save(instead(p, "p0.jpg"), quality=98)


@result(GROUP, "16-bit PNG", shows_the_view(tolerance=1e-3))
def sixteen_bit_png(p: Project) -> None:
    encoded = (to_srgb8(picture(0)[0]).astype(np.uint16) * 257)[..., ::-1]
    cv2.imwrite(str(p.images / "p0.png"), encoded)


@result(GROUP, "16-bit TIFF with an alpha channel that is all opaque", shows_the_view())
def sixteen_bit_tiff(p: Project) -> None:
    encoded = to_srgb8(picture(0)[0]).astype(np.uint16)[..., ::-1] * 257
    rgba = np.dstack([encoded, np.full((HEIGHT, WIDTH), 65535, np.uint16)])
    cv2.imwrite(str(instead(p, "p0.tif")), rgba)


@message(GROUP, "TIFF of 32-bit floats", "p0.tif", "EXR")
def float_tiff(p: Project) -> None:
    cv2.imwrite(str(instead(p, "p0.tif")), picture(0)[0])


@result(GROUP, "TIFF in Lab colours", shows_the_view(tolerance=0.03))
def lab(p: Project) -> None:
    profiles = ImageCms.createProfile("sRGB"), ImageCms.createProfile("LAB")
    converted = ImageCms.profileToProfile(eight_bit(), *profiles, outputMode="LAB")
    assert converted is not None
    converted.save(instead(p, "p0.tif"))


@result(GROUP, "PNG of 256 colours", shows_the_view(tolerance=0.05))
def palette(p: Project) -> None:
    eight_bit().quantize(256).save(p.images / "p0.png")


@result(GROUP, "HEIC called .jpg", lambda p: heic_is_right(p))
def heic_called_jpg(p: Project) -> None:
    heic_of(p, "p0.jpg")


@result(GROUP, "JPEG called .heic", right)
def jpeg_called_heic(p: Project) -> None:
    instead(p, "p0.heic", jpeg())


@result(GROUP, "EXR called .png", right)
def exr_called_png(p: Project) -> None:
    write_channels(p.images / "p0.png", {"RGB": picture(0)[0]})


@result(GROUP, "WebP called .jpg", shows_the_view(tolerance=0.04))
def webp_called_jpg(p: Project) -> None:
    eight_bit().save(instead(p, "p0.jpg"), "WEBP", quality=98)


@message(GROUP, "a web page called .jpg", "p0.jpg", "cannot be read")
def web_page(p: Project) -> None:
    instead(p, "p0.jpg", b"<!DOCTYPE html><html><body>404</body></html>")


@result(GROUP, "a folder called frame.jpg beside the photos", right)
def folder_called_jpg(p: Project) -> None:
    p.transforms.unlink()
    (p.scene / "mesh.obj").unlink()
    (p.images / "frame.jpg").mkdir()


@message(GROUP, "a link to nowhere", "p9.jpg")
def dangling(p: Project) -> None:
    p.transforms.unlink()
    (p.images / "p9.jpg").symlink_to("nowhere.jpg")


@message(GROUP, "damaged colour profile", "p0.jpg", "colours")
def damaged_profile(p: Project) -> None:
    instead(p, "p0.jpg", jpeg(icc_profile=b"\0" * 40))


@message(GROUP, "colour profile that claims more tags than it has", "p0.jpg", "colours")
def short_profile(p: Project) -> None:
    head = bytearray(132)
    head[12:24] = b"mntrRGB XYZ "
    head[36:40] = b"acsp"
    struct.pack_into(">I", head, 128, 900)
    instead(p, "p0.jpg", jpeg(icc_profile=bytes(head)))


# --- EXIF ------------------------------------------------------------------------------------


def exif(number: int, **tags) -> Image.Exif:
    """EXIF of a photo: `time`, `f_number`, `iso`, `focal_35mm`, `orientation`."""
    out = Image.Exif()
    ifd = out.get_ifd(EXIF_IFD)
    names = {"time": 0x829A, "f_number": 0x829D, "iso": 0x8827, "focal_35mm": 0xA405}
    for name, key in names.items():
        if name in tags:
            ifd[key] = tags[name]
    if "orientation" in tags:
        out[ORIENTATION] = tags["orientation"]
    return out


def with_exif(p: Project, tags: list[dict]) -> None:
    """All photos as JPEG with EXIF of their own."""
    cameras = p.cameras()
    for k, own in enumerate(tags):
        (p.images / f"p{k}.png").unlink()
        (p.images / f"p{k}.jpg").write_bytes(jpeg(k, exif=exif(k, **own)))
        cameras["frames"][k]["file_path"] = f"images/p{k}.jpg"
    p.write_cameras(cameras)


@result(GROUP, "EXIF that lies about exposure", right)
def lying_exposure(p: Project) -> None:
    times = (1 / 1000, 1 / 10, 1 / 2, 1 / 60)
    with_exif(p, [{"time": t, "f_number": 4.0, "iso": 100} for t in times])


@result(GROUP, "EXIF with an exposure of no time and an infinite one", right)
def odd_exposure(p: Project) -> None:
    times = (IFDRational(1, 0), IFDRational(0, 1), IFDRational(0, 0), 0.01)
    with_exif(p, [{"time": t, "f_number": 4.0, "iso": 100} for t in times])


@result(GROUP, "EXIF whose sensitivity is a text", right)
def text_for_iso(p: Project) -> None:
    with_exif(p, [{"time": 0.01, "f_number": 4.0, "iso": "high"} for _ in range(4)])


@message(
    GROUP, "EXIF that turns a photo which is upright", "p0", "not the same shape", stages=TO_POSES
)
def lying_orientation(p: Project) -> None:
    with_exif(p, [{"orientation": 6}] + [{}] * 3)
    (p.masks / "p0.png").unlink()
    Image.fromarray(np.rot90(picture(0)[1] * np.uint8(255), 3)).save(p.masks / "p0.png")


@result(GROUP, "damaged EXIF", right)
def damaged_exif(p: Project) -> None:
    data = exif(0, time=0.01, iso=100).tobytes()
    instead(p, "p0.jpg", jpeg(exif=data[:14] + b"\xff" * (len(data) - 14)))


# --- EXR -------------------------------------------------------------------------------------


def write_channels(path, channels: dict[str, np.ndarray], **header) -> None:
    """An EXR file of any channels."""
    head = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage} | header
    with OpenEXR.File(head, channels) as file:
        file.write(str(path))


def as_exr(p: Project, channels: dict[str, np.ndarray], **header) -> None:
    write_channels(instead(p, "p0.exr"), channels, **header)


@result(GROUP, "EXR with more layers beside its colours", right)
def multilayer(p: Project) -> None:
    linear = picture(0)[0]
    as_exr(p, {"RGB": linear, "depth.Z": linear[..., 0] * 9, "diffuse.RGB": linear * 3})


@message(GROUP, "EXR whose colours lie in layers", "p0.exr", "beauty", "R, G, B")
def only_layers(p: Project) -> None:
    linear = picture(0)[0]
    as_exr(p, {"beauty.RGB": linear, "depth.Z": linear[..., 0]})


@message(GROUP, "EXR with depth alone", "p0.exr", "Z", "R, G, B")
def only_depth(p: Project) -> None:
    as_exr(p, {"Z": picture(0)[0][..., 0]})


@message(GROUP, "EXR with NaN", "p0.exr", "NaN")
def exr_nan(p: Project) -> None:
    linear = picture(0)[0].copy()
    linear[3, 4] = np.nan
    as_exr(p, {"RGB": linear})


@message(GROUP, "EXR with infinity in a half", "p0.exr", "infinity")
def exr_infinite(p: Project) -> None:
    linear = picture(0)[0].astype(np.float16)
    linear[3, 4] = np.inf
    as_exr(p, {"RGB": linear})


def no_negatives(p: Project) -> None:
    right(p)
    found = read_exr(p.work / "capture" / "images" / "p0.exr")
    assert found.min() >= 0, f"radiance {found.min()}"


@result(GROUP, "EXR with negative values", no_negatives)
def exr_negative(p: Project) -> None:
    linear = picture(0)[0].copy()
    linear[:2] = -0.2
    as_exr(p, {"RGB": linear})


def alpha_is_mask(p: Project) -> None:
    found = read_exr(p.work / "capture" / "images" / "p0.exr")
    linear, mask = picture(0)
    file = p.work / "capture" / "masks" / "p0.png"
    assert file.exists(), "alpha is not taken for a mask"
    with Image.open(file) as image:
        assert (np.asarray(image) > 127).tolist() == mask.tolist(), "alpha is not the mask"
    assert np.abs(found - linear)[mask].mean() < 0.01, "colours on the object"


@result(GROUP, "EXR whose alpha channel cuts the object out", alpha_is_mask)
def exr_alpha(p: Project) -> None:
    linear, mask = picture(0)
    as_exr(p, {"RGBA": np.dstack([linear * mask[..., None], mask]).astype(np.float32)})
    (p.masks / "p0.png").unlink()


@result(GROUP, "EXR of which only a window is stored", lambda p: window_is_right(p))
def exr_window(p: Project) -> None:
    data = np.array([10, 5], np.int32), np.array([WIDTH - 11, HEIGHT - 6], np.int32)
    display = np.array([0, 0], np.int32), np.array([WIDTH - 1, HEIGHT - 1], np.int32)
    inner = np.ascontiguousarray(picture(0)[0][5 : HEIGHT - 5, 10 : WIDTH - 10])
    as_exr(p, {"RGB": inner}, dataWindow=data, displayWindow=display)


def window_is_right(p: Project) -> None:
    found = read_exr(p.work / "capture" / "images" / "p0.exr")
    expected = picture(0)[0]
    inside = np.s_[5 : HEIGHT - 5, 10 : WIDTH - 10]
    assert found.shape == expected.shape, f"{found.shape} for {expected.shape}"
    assert np.abs(found[inside] - expected[inside]).max() < 0.01, "shifted"


@message(GROUP, "EXR cut in the middle", "p0.exr", "EXR")
def cut_exr(p: Project) -> None:
    as_exr(p, {"RGB": picture(0)[0]})
    data = (p.images / "p0.exr").read_bytes()
    (p.images / "p0.exr").write_bytes(data[: len(data) // 2])


# --- HEIC ------------------------------------------------------------------------------------


def heic_of(p: Project, name: str) -> None:
    instead(p, name, HEIC.read_bytes())
    (p.masks / "p0.png").unlink()


def heic_is_right(p: Project) -> None:
    found = read_exr(p.work / "capture" / "images" / "p0.exr")
    assert found.shape == (48, 64, 3), f"{found.shape}"


@message(GROUP, "HEIC cut in the middle", "p0.heic", "cannot be read")
def cut_heic(p: Project) -> None:
    heic_of(p, "p0.heic")
    data = (p.images / "p0.heic").read_bytes()
    (p.images / "p0.heic").write_bytes(data[: len(data) // 2])


def warned(project: Project) -> None:
    """Check that the user was told."""
    said = read_json(project.work / "capture" / "capture.json")["warnings"]
    assert any("out of focus" in text for text in said), f"warnings: {said}"


@result(GROUP, "all photos out of focus", warned)
def out_of_focus(p: Project) -> None:
    for file in sorted(p.images.glob("*.png")):
        with Image.open(file) as image:
            soft = image.filter(ImageFilter.GaussianBlur(4))
        soft.save(file)
