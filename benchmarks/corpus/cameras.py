"""Cases of transforms.json: ragged, textual, scaled, mirrored and other matrices, and lenses."""

from __future__ import annotations

import json
from collections.abc import Callable

import numpy as np

from benchmarks.corpus.case import message, result
from benchmarks.corpus.project import HEIGHT, VIEWS, WIDTH, Project, pose
from pipeline.geometry.cameras import load_cameras

GROUP = "transforms.json"
STAGES = ("capture", "poses")


def cameras_are_right(p: Project) -> None:
    rig = load_cameras(p.work / "poses" / "cameras.json")
    assert len(rig.views) == VIEWS, f"{len(rig.views)} views"
    for view in rig.views:
        expected = pose(int(view.name[-1]))
        error = np.abs(view.world_to_camera - expected).max()
        assert error < 1e-4, f"{view.name}: world to camera differs by {error:.4f}"


def spoilt(change: Callable[[dict], object]) -> Callable[[Project], None]:
    """Write transforms.json with something changed in it."""

    def spoil(p: Project) -> None:
        cameras = p.cameras()
        change(cameras)
        p.write_cameras(cameras)

    return spoil


def matrix(cameras: dict, change: Callable[[np.ndarray], object], first: int = 1) -> None:
    """Change the matrices of the frames from `first` on."""
    for frame in cameras["frames"][first:]:
        values = np.array(frame["transform_matrix"])
        changed = change(values)
        frame["transform_matrix"] = changed.tolist() if isinstance(changed, np.ndarray) else changed


MATRIX = "transform_matrix"
REFUSED: list[tuple[str, Callable[[dict], object], tuple[str, ...]]] = [
    (
        "a ragged matrix",
        lambda c: c["frames"][1][MATRIX][2].pop(),
        ("p1", "4x4"),
    ),
    ("a matrix of 3 x 3", lambda c: matrix(c, lambda m: m[:3, :3]), ("p1", "4x4")),
    ("no matrix", lambda c: c["frames"][1].pop(MATRIX), ("p1", MATRIX)),
    (
        "words in a matrix",
        lambda c: c["frames"][1][MATRIX][0].__setitem__(0, "left"),
        ("p1", MATRIX, "left"),
    ),
    (
        "NaN in a matrix",
        lambda c: c["frames"][1][MATRIX][0].__setitem__(0, float("nan")),
        ("p1", MATRIX),
    ),
    (
        "a mirrored matrix",
        lambda c: matrix(c, lambda m: m @ np.diag([-1, 1, 1, 1])),
        ("p1", "mirrored"),
    ),
    (
        "a sheared matrix",
        lambda c: matrix(c, lambda m: m @ (np.eye(4) + 0.3 * np.eye(4, k=1))),
        ("p1", "rigid"),
    ),
    (
        "axes of different lengths",
        lambda c: matrix(c, lambda m: m @ np.diag([1, 2, 1, 1])),
        ("p1", "rigid"),
    ),
    ("a transposed matrix", lambda c: matrix(c, lambda m: m.T), ("p1", "last row", "transposed")),
    ("a matrix of zeros", lambda c: matrix(c, lambda m: m * 0), ("p1",)),
    (
        "the same place for all cameras",
        lambda c: matrix(c, lambda m: np.eye(4), first=0),
        ("transforms.json", "one place"),
    ),
    ("a focal length of words", lambda c: c.update(fl_x="long"), ("fl_x", "long")),
    ("a negative focal length", lambda c: c.update(fl_x=-90.0), ("fl_x", "-90")),
    ("no focal length", lambda c: c.pop("fl_x"), ("transforms.json", "fl_x")),
    (
        "an angle of view in degrees",
        lambda c: (c.pop("fl_x"), c.update(camera_angle_x=43.6)),
        ("camera_angle_x", "radians"),
    ),
    (
        "the principal point far outside",
        lambda c: c.update(cx=5000.0),
        ("transforms.json", "cx", "5000"),
    ),
    ("a list for the width", lambda c: c.update(w=[WIDTH]), ("transforms.json", "w")),
    ("a width of zero", lambda c: c.update(w=0), ("transforms.json", "w")),
    (
        "another shape than the photos",
        lambda c: c.update(w=HEIGHT, h=WIDTH),
        ("not the same shape",),
    ),
    ("a fisheye lens", lambda c: c.update(camera_model="OPENCV_FISHEYE"), ("OPENCV_FISHEYE",)),
    ("instant-ngp's mark of a fisheye", lambda c: c.update(is_fisheye=True), ("fisheye",)),
    ("a panorama", lambda c: c.update(camera_model="EQUIRECTANGULAR"), ("EQUIRECTANGULAR",)),
    ("a sixth distortion coefficient", lambda c: c.update(k3=0.1), ("k3",)),
    ("absurd distortion", lambda c: c.update(k1=1e9), ("distortion",)),
    ("infinite distortion", lambda c: c.update(k1=float("inf")), ("k1",)),
    ("frames that are no list", lambda c: c.update(frames=7), ("transforms.json", "frames")),
    ("no frames", lambda c: c.update(frames=[]), ("photos",)),
    (
        "a frame without a file",
        lambda c: c["frames"][1].pop("file_path"),
        ("transforms.json", "file_path"),
    ),
    (
        "a number for a file",
        lambda c: c["frames"][1].update(file_path=3),
        ("transforms.json", "file_path"),
    ),
    (
        "frames whose photos are missing",
        lambda c: c["frames"][1].update(file_path="images/gone.png"),
        ("gone.png", "transforms.json", "add the photos"),
    ),
    (
        "a photo outside of the scene",
        lambda c: c["frames"][1].update(file_path="../../etc/x.png"),
        ("outside", "x.png"),
    ),
    (
        "one photo in two frames",
        lambda c: c["frames"][1].update(file_path="images/p0.png"),
        ("p0", "two"),
    ),
]
for _name, _change, _words in REFUSED:
    message(GROUP, _name, *_words, stages=STAGES)(spoilt(_change))


ACCEPTED: list[tuple[str, Callable[[dict], object]]] = [
    ("matrices scaled by 3", lambda c: matrix(c, lambda m: m @ np.diag([3, 3, 3, 1]), 0)),
    ("matrices scaled each by its own factor", lambda c: _scaled_each(c)),
    ("numbers written as texts", lambda c: matrix(c, lambda m: m.astype(str), 0)),
    ("matrices rounded to three digits", lambda c: matrix(c, lambda m: m.round(6), 0)),
    ("the axes of Blender's exporter: focal length as an angle", lambda c: _as_angle(c)),
]


def _scaled_each(cameras: dict) -> None:
    for k, frame in enumerate(cameras["frames"]):
        frame[MATRIX] = (np.array(frame[MATRIX]) @ np.diag([k + 1.5] * 3 + [1])).tolist()


def _as_angle(cameras: dict) -> None:
    cameras["camera_angle_x"] = 2 * np.arctan(0.5 * cameras["w"] / cameras.pop("fl_x"))


for _name, _change in ACCEPTED:
    result(GROUP, _name, cameras_are_right, stages=STAGES)(spoilt(_change))


@result(GROUP, "a byte order mark before it", cameras_are_right, stages=STAGES)
def byte_order_mark(p: Project) -> None:
    p.transforms.write_text(json.dumps(p.cameras()), encoding="utf-8-sig")


@message(GROUP, "cut in the middle", "transforms.json", "JSON")
def cut(p: Project) -> None:
    text = json.dumps(p.cameras())
    p.transforms.write_text(text[: len(text) // 2], encoding="utf-8")


@message(GROUP, "a list instead of a mapping", "transforms.json")
def a_list(p: Project) -> None:
    p.transforms.write_text("[1, 2]", encoding="utf-8")


@message(GROUP, "100 000 brackets", "transforms.json")
def brackets(p: Project) -> None:
    p.transforms.write_text("[" * 100_000, encoding="utf-8")


@message(GROUP, "bytes that are no UTF-8", "transforms.json")
def no_text(p: Project) -> None:
    p.transforms.write_bytes(b"\xff\xfe\x00\x80" * 50)


@message(GROUP, "broken test views", "transforms_test.json")
def broken_test_views(p: Project) -> None:
    (p.scene / "transforms_test.json").write_text('{"frames": [{}]}', encoding="utf-8")
