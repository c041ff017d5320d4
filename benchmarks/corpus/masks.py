"""Cases of masks of another size, name, suffix, colour or meaning, and of equal names of photos."""

from __future__ import annotations

import numpy as np
from PIL import Image

from benchmarks.corpus.case import message, result
from benchmarks.corpus.project import HEIGHT, VIEWS, WIDTH, Project, picture
from pipeline.base.images import to_srgb8

GROUP = "mask"
TO_MASKS = ("capture", "poses", "masks")


def captured(p: Project, name: str = "p0") -> np.ndarray | None:
    """The mask (h, w) bool that the capture stage kept of a photo, None where it kept none."""
    file = p.work / "capture" / "masks" / f"{name}.png"
    if not file.exists():
        return None
    with Image.open(file) as image:
        return np.asarray(image) > 127


def is_the_ball(p: Project) -> None:
    found = captured(p)
    assert found is not None, "no mask was kept"
    assert (found == picture(0)[1]).all(), f"{(found != picture(0)[1]).sum()} pixels differ"


def masked(number: int = 0) -> np.ndarray:
    """A view's mask (h, w), uint8."""
    return picture(number)[1] * np.uint8(255)


def put(p: Project, pixels: np.ndarray, name: str = "p0.png", mode: str | None = None) -> None:
    """Another file in place of the first photo's mask."""
    (p.masks / "p0.png").unlink()
    Image.fromarray(pixels, mode).save(p.masks / name)


@message(GROUP, "of another size", "p0.png", "36x28", f"{WIDTH}x{HEIGHT}", "size")
def another_size(p: Project) -> None:
    put(p, masked()[::2, ::2])


@message(GROUP, "on its side", "p0.png", f"{HEIGHT}x{WIDTH}", f"{WIDTH}x{HEIGHT}")
def on_its_side(p: Project) -> None:
    put(p, np.ascontiguousarray(np.rot90(masked())))


def left_out_is_told(p: Project) -> None:
    told = str(p.result("capture")["warnings"])
    assert "other.png" in told and "mask" in told, told


@result(GROUP, "called like no photo", left_out_is_told)
def another_name(p: Project) -> None:
    (p.masks / "p0.png").rename(p.masks / "other.png")


@result(
    GROUP,
    "with a suffix that is not read",
    lambda p: _told(p, "p0.tif", "mask"),
)
def another_suffix(p: Project) -> None:
    put(p, masked(), "p0.tif")


def _told(p: Project, *words: str) -> None:
    told = str(p.result("capture")["warnings"])
    assert all(word in told for word in words), told


@result(GROUP, "with its suffix in capitals", is_the_ball)
def capitals(p: Project) -> None:
    put(p, masked(), "p0.PNG")


@message(GROUP, "all black", "p0.png", "black")
def all_black(p: Project) -> None:
    put(p, np.zeros_like(masked()))


@message(GROUP, "of zeros and ones", "p0.png", "1 of 255")
def zeros_and_ones(p: Project) -> None:
    put(p, masked() // 255)


@message(GROUP, "painted dark red", "p0.png", "of 255", "white")
def red(p: Project) -> None:
    put(p, masked()[..., None] * np.array([0.9, 0, 0]).astype(np.float32).astype(np.uint8))


@message(GROUP, "painted red on black", "p0.png", "of 255", "white")
def red_on_black(p: Project) -> None:
    colored = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    colored[..., 0] = masked()
    put(p, colored)


@result(GROUP, "16-bit", is_the_ball)
def sixteen_bit(p: Project) -> None:
    put(p, masked().astype(np.uint16) * 257)


@message(GROUP, "16-bit, of zeros and 255", "p0.png", "black")
def sixteen_bit_dark(p: Project) -> None:
    put(p, masked().astype(np.uint16))


@result(GROUP, "1-bit", is_the_ball)
def one_bit(p: Project) -> None:
    Image.fromarray(masked()).convert("1").save(p.masks / "p0.png")


@result(GROUP, "white, with the object in its alpha channel", is_the_ball)
def in_alpha(p: Project) -> None:
    rgba = np.full((HEIGHT, WIDTH, 4), 255, np.uint8)
    rgba[..., 3] = masked()
    put(p, rgba)


@message(GROUP, "a photo in place of a mask", "p0.png", "grey")
def photo_for_mask(p: Project) -> None:
    put(p, to_srgb8(picture(0)[0]))


@message(GROUP, "black and white exchanged in all", "exchanged", "white", stages=TO_MASKS)
def exchanged(p: Project) -> None:
    for k in range(VIEWS):
        Image.fromarray(255 - masked(k)).save(p.masks / f"p{k}.png")


@message(GROUP, "all white in all", "masks", "100.0 %", stages=TO_MASKS)
def all_white(p: Project) -> None:
    for k in range(VIEWS):
        Image.fromarray(np.full((HEIGHT, WIDTH), 255, np.uint8)).save(p.masks / f"p{k}.png")


@message(GROUP, "cut in the middle", "p0.png", "mask cannot be read")
def cut(p: Project) -> None:
    data = (p.masks / "p0.png").read_bytes()
    (p.masks / "p0.png").write_bytes(data[: len(data) // 2])


@message(GROUP, "zero bytes", "p0.png", "mask cannot be read")
def zero_bytes(p: Project) -> None:
    (p.masks / "p0.png").write_bytes(b"")


# --- photos of equal names in subfolders ------------------------------------------------------


def in_subfolders(p: Project) -> None:
    """p0 and p1 become a/x and b/x; their masks stay where they are."""
    cameras = p.cameras()
    for k, folder in enumerate(("a", "b")):
        (p.images / folder).mkdir()
        (p.images / f"p{k}.png").rename(p.images / folder / "x.png")
        cameras["frames"][k]["file_path"] = f"images/{folder}/x.png"
    p.write_cameras(cameras)


def each_its_own(p: Project) -> None:
    for k, name in enumerate(("a_x", "b_x")):
        found = captured(p, name)
        assert found is not None, f"{name} has no mask"
        assert (found == picture(k)[1]).all(), f"{name} has the other's mask"


@message(GROUP, "one for two photos of one stem", "x.png", "a/x.png", "b/x.png")
def one_for_two(p: Project) -> None:
    in_subfolders(p)
    (p.masks / "p0.png").rename(p.masks / "x.png")
    (p.masks / "p1.png").unlink()


@result(GROUP, "in subfolders like their photos", each_its_own)
def masks_in_subfolders(p: Project) -> None:
    in_subfolders(p)
    for k, folder in enumerate(("a", "b")):
        (p.masks / folder).mkdir()
        (p.masks / f"p{k}.png").rename(p.masks / folder / "x.png")


@result(GROUP, "called by folder and stem", each_its_own)
def masks_by_joined_name(p: Project) -> None:
    in_subfolders(p)
    for k, folder in enumerate(("a", "b")):
        (p.masks / f"p{k}.png").rename(p.masks / f"{folder}_x.png")


@message(GROUP, "photos a/x.png and a_x.png", "a/x.png", "a_x.png", "called 'a_x'")
def two_of_one_name(p: Project) -> None:
    in_subfolders(p)
    (p.images / "p2.png").rename(p.images / "a_x.png")
    cameras = p.cameras()
    paths = ("a/x.png", "b/x.png", "a_x.png", "p3.png")
    for frame, path in zip(cameras["frames"], paths):
        frame["file_path"] = f"images/{path}"
    p.write_cameras(cameras)
