"""Doubles and blurred photos, in JPEG files of a textured scene seen from 16 places."""

import json

import cv2
import numpy as np
import pytest
from PIL import Image

from pipeline.base.config import Capture
from pipeline.base.errors import InputError
from pipeline.photos.capture import capture
from tests.seeds import numpy_rng

VIEWS = 16


def world(size=900) -> np.ndarray:
    """Texture of all scales, in [0, 1]."""
    rng = numpy_rng(0)
    out = np.zeros((size, size), np.float32)
    for sigma in (1.0, 3.0, 10.0, 30.0):
        layer = cv2.GaussianBlur(rng.normal(size=(size, size)).astype(np.float32), (0, 0), sigma)
        out += layer / layer.std()
    return np.clip(0.5 + 0.1 * out, 0, 1)


WORLD = world()


def photo(view: int, shift=0.0, blur=0, noise=0) -> np.ndarray:
    """A cut-out (200, 300, 3) uint8 of the world; `blur`: length of a motion in pixels."""
    place = np.float32([[1, 0, -(20 * view + shift)], [0, 1, -(15 * view + 0.5 * shift)]])
    grey = cv2.warpAffine(WORLD, place, (300, 200))
    if blur:
        grey = cv2.blur(grey, (blur, 1 + blur // 2))
    grey = grey + 0.01 * numpy_rng(noise).normal(size=grey.shape)
    return (255 * np.clip(np.repeat(grey[..., None], 3, 2), 0, 1)).astype(np.uint8)


def captured(tmp_path, pictures: dict[str, np.ndarray], cameras=False, **settings):
    scene, out = tmp_path / "scene", tmp_path / "out"
    (scene / "images").mkdir(parents=True)
    out.mkdir()
    for name, picture in pictures.items():
        Image.fromarray(picture).save(scene / "images" / name, quality=92)
    if cameras:
        frames = [
            {"file_path": f"images/{n}", "transform_matrix": np.eye(4).tolist()} for n in pictures
        ]
        (scene / "transforms.json").write_text(json.dumps({"frames": frames}))
    metrics = capture(scene, out, Capture(**settings))
    facts = json.loads((out / "photos.json").read_text())
    return out, metrics, [p["file"].removeprefix("images/") for p in facts["photos"]]


def orbit() -> dict[str, np.ndarray]:
    return {f"{k:02d}.jpg": photo(k, noise=k) for k in range(VIEWS)}


def test_a_plain_orbit_keeps_every_photo(tmp_path):
    _, metrics, names = captured(tmp_path, orbit())
    assert len(names) == VIEWS and metrics["left_out"] == 0 and metrics["warnings"] == []


def test_of_a_burst_the_sharpest_stays(tmp_path):
    burst = {
        "05b.jpg": photo(5, shift=0.3, noise=50),
        "05c.jpg": photo(5, shift=-0.3, noise=51),
        "99 copy.jpg": photo(2, blur=3, noise=52),  # not beside its double, and less sharp
    }
    out, metrics, names = captured(tmp_path, orbit() | burst)
    assert len(names) == VIEWS and metrics["left_out"] == 3
    assert sum(name.startswith("05") for name in names) == 1
    assert "99 copy.jpg" not in names and "02.jpg" in names
    (text,) = metrics["warnings"]
    assert "burst" in text and "99 copy.jpg (as images/02.jpg)" in text
    left = {p.stem for p in (out / "images").iterdir()}
    assert left == {p.stem for p in (out / "saturated").iterdir()}
    assert left == {name[:-4] for name in names}


def test_neighbours_closer_than_usual_are_no_doubles(tmp_path):
    _, _, names = captured(tmp_path, orbit() | {"05b.jpg": photo(5, shift=4, noise=50)})
    assert len(names) == VIEWS + 1


def test_blurred_photos_are_left_out(tmp_path):
    pictures = orbit()
    pictures["04.jpg"] = photo(4, blur=9, noise=4)
    pictures["11.jpg"] = photo(11, blur=13, noise=11)
    _, metrics, names = captured(tmp_path, pictures)
    assert set(pictures) - set(names) == {"04.jpg", "11.jpg"}
    assert "blurred" in metrics["warnings"][0] and "images/11.jpg" in metrics["warnings"][0]


def test_never_more_than_a_fifth_and_the_worst_first(tmp_path):
    pictures = orbit()
    for k, blur in ((2, 7), (5, 9), (8, 11), (11, 15), (14, 19)):
        pictures[f"{k:02d}.jpg"] = photo(k, blur=blur, noise=k)
    _, _, names = captured(tmp_path, pictures)
    assert set(pictures) - set(names) == {"08.jpg", "11.jpg", "14.jpg"}  # 3 = 16 / 5, rounded down


@pytest.mark.parametrize("how", ["switch", "given cameras"])
def test_everything_stays_where_asked_for_or_named(tmp_path, how):
    pictures = orbit() | {"04.jpg": photo(4, blur=13), "05b.jpg": photo(5, noise=9)}
    settings = {"leave_out": "none"} if how == "switch" else {"cameras": True}
    assert len(captured(tmp_path, pictures, **settings)[2]) == len(pictures)


def test_a_set_of_doubles_is_refused(tmp_path):
    with pytest.raises(InputError, match="only 1 photos show something of their own"):
        captured(tmp_path, {f"{k}.jpg": photo(0, noise=k) for k in range(5)})
