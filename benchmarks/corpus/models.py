"""Cases of COLMAP models: other lenses, damaged files, images of equal names."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.corpus.case import message, result
from benchmarks.corpus.masks import in_subfolders
from benchmarks.corpus.project import (
    FOCAL,
    HEIGHT,
    RADIUS,
    VIEWS,
    WIDTH,
    Project,
    pose,
    view,
)
from pipeline.geometry.cameras import load_cameras
from pipeline.geometry.mesh_io import unit

GROUP = "COLMAP model"
STAGES = ("capture", "poses")
PINHOLE = f"1 PINHOLE {WIDTH} {HEIGHT} {FOCAL} {FOCAL} {WIDTH / 2} {HEIGHT / 2}"
POINTS = 80


def sightings() -> tuple[np.ndarray, list[list[tuple[int, float, float]]]]:
    """Points (POINTS, 3) of the ball, and for each of them view, u and v of where it is seen."""
    points = RADIUS * unit(np.random.default_rng(0).normal(size=(POINTS, 3)))
    seen: list[list[tuple[int, float, float]]] = [[] for _ in points]
    for number in range(VIEWS):
        camera = view(number)
        facing = (points * (camera.position - points)).sum(1) > 0
        uv, _ = camera.project(points)
        for k in np.flatnonzero(facing):
            seen[k].append((number, *uv[k]))
    return points, seen


def image_line(number: int, name: str | None = None, factor: float = 1.0) -> str:
    """One image of images.txt; factor: what its quaternion's length is."""
    x, y, z, w = factor * Rotation.from_matrix(pose(number)[:3, :3]).as_quat()
    shift = " ".join(str(v) for v in pose(number)[:3, 3])
    return f"{number + 1} {w} {x} {y} {z} {shift} 1 {name or f'p{number}.png'}"


def write_text(
    p: Project,
    camera: str = PINHOLE,
    images: list[str] | None = None,
    folder: str = "sparse/0",
) -> Path:
    """The ball's model as text in place of transforms.json; its folder."""
    if p.transforms.exists():
        p.transforms.unlink()
    out = p.scene / folder
    out.mkdir(parents=True)
    points, seen = sightings()
    keypoints: list[list[str]] = [[] for _ in range(VIEWS)]
    lines = []
    for k, (point, views) in enumerate(zip(points, seen)):
        track = [f"{number + 1} {len(keypoints[number])}" for number, _, _ in views]
        for number, u, v in views:
            keypoints[number].append(f"{u} {v} {k + 1}")
        where = " ".join(str(v) for v in point)
        lines.append(f"{k + 1} {where} 128 128 128 0.5 {' '.join(track)}")

    rows = images or [image_line(k) for k in range(VIEWS)]
    both = [f"{row}\n{' '.join(keys)}" for row, keys in zip(rows, keypoints)]
    (out / "cameras.txt").write_text(camera + "\n", encoding="utf-8")
    (out / "images.txt").write_text("\n".join(both) + "\n", encoding="utf-8")
    (out / "points3D.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return out


def write_binary(p: Project, parameters: tuple = (FOCAL, FOCAL, WIDTH / 2, HEIGHT / 2)) -> Path:
    """The ball's model as binary files (PINHOLE), without keypoints and points; its folder."""
    p.transforms.unlink()
    out = p.scene / "sparse" / "0"
    out.mkdir(parents=True)
    camera = struct.pack("<QIiQQ4d", 1, 1, 1, WIDTH, HEIGHT, *parameters)
    images = struct.pack("<Q", VIEWS)
    for k in range(VIEWS):
        x, y, z, w = Rotation.from_matrix(pose(k)[:3, :3]).as_quat()
        images += struct.pack("<I7dI", k + 1, w, x, y, z, *pose(k)[:3, 3], 1)
        images += f"p{k}.png".encode() + b"\0" + struct.pack("<Q", 0)
    (out / "cameras.bin").write_bytes(camera)
    (out / "images.bin").write_bytes(images)
    (out / "points3D.bin").write_bytes(struct.pack("<Q", 0))
    return out


def cameras_agree(p: Project) -> None:
    """Relative turns, and distances from the first camera over one another: the world is a new
    one.
    """
    rig = load_cameras(p.work / "poses" / "cameras.json")
    assert len(rig.views) == VIEWS, f"{len(rig.views)} views"
    found = {v.name[-5:].strip("./"): v for v in rig.views}
    turns = [found[f"p{k}"].world_to_camera[:3, :3] for k in range(VIEWS)]
    places = np.stack([found[f"p{k}"].position for k in range(VIEWS)])
    expected = np.stack([view(k).position for k in range(VIEWS)])
    for k in range(VIEWS):
        turn = pose(k)[:3, :3] @ pose(0)[:3, :3].T
        assert np.abs(turns[k] @ turns[0].T - turn).max() < 1e-4, f"turn of view {k}"
    apart = np.linalg.norm(places - places[0], axis=1) / np.linalg.norm(places[1] - places[0])
    wanted = np.linalg.norm(expected - expected[0], axis=1)
    assert np.allclose(apart, wanted / wanted[1], atol=1e-4), "distances"


@result(GROUP, "as text", cameras_agree, stages=STAGES)
def as_text(p: Project) -> None:
    write_text(p)


@result(GROUP, "as binary files", cameras_agree, stages=STAGES)
def as_binary(p: Project) -> None:
    write_binary(p)


@result(GROUP, "in sparse/ instead of sparse/0/", cameras_agree, stages=STAGES)
def without_zero(p: Project) -> None:
    write_text(p, folder="sparse")


@result(GROUP, "with quaternions of length 2", cameras_agree, stages=STAGES)
def long_quaternions(p: Project) -> None:
    write_text(p, images=[image_line(k, factor=2.0) for k in range(VIEWS)])


LENSES = {
    "FULL_OPENCV": f"{FOCAL} {FOCAL} {WIDTH / 2} {HEIGHT / 2} 0 0 0 0 .1 0 0 0",
    "OPENCV_FISHEYE": f"{FOCAL} {FOCAL} {WIDTH / 2} {HEIGHT / 2} 0 0 0 0",
    "FOV": f"{FOCAL} {FOCAL} {WIDTH / 2} {HEIGHT / 2} .5",
    "THIN_PRISM_FISHEYE": f"{FOCAL} {FOCAL} {WIDTH / 2} {HEIGHT / 2} 0 0 0 0 0 0 0 0",
}
for _lens, _parameters in LENSES.items():
    message(GROUP, f"lens {_lens}", _lens, "sparse/0", "PINHOLE", stages=STAGES)(
        lambda p, lens=_lens, values=_parameters: write_text(
            p, f"1 {lens} {WIDTH} {HEIGHT} {values}"
        )
    )


def refuse(name: str, *words: str) -> Callable:
    """A case that must be refused, naming sparse/0."""
    return message(GROUP, name, "sparse/0", *words, stages=STAGES)


@refuse("a lens that does not exist")
def unknown_lens(p: Project) -> None:
    write_text(p, f"1 LENSBABY {WIDTH} {HEIGHT} {FOCAL}")


@refuse("too few parameters of the lens")
def few_parameters(p: Project) -> None:
    write_text(p, f"1 PINHOLE {WIDTH} {HEIGHT} {FOCAL}")


@refuse("NaN for a focal length", "focal")
def nan_focal(p: Project) -> None:
    write_text(p, PINHOLE.replace(str(FOCAL), "nan"))


@refuse("a focal length of 0", "focal")
def no_focal(p: Project) -> None:
    write_binary(p, (0.0, 0.0, WIDTH / 2, HEIGHT / 2))


@refuse("NaN in a pose")
def nan_pose(p: Project) -> None:
    rows = [image_line(k) for k in range(VIEWS)]
    words = rows[1].split()
    words[5] = "nan"
    write_text(p, images=[rows[0], " ".join(words), *rows[2:]])


@refuse("an image whose camera is missing")
def missing_camera(p: Project) -> None:
    rows = [image_line(k) for k in range(VIEWS)]
    write_text(p, images=[rows[0].replace(" 1 p0.png", " 7 p0.png"), *rows[1:]])


@refuse("no image registered", "0")
def nothing_registered(p: Project) -> None:
    folder = write_text(p)
    (folder / "images.txt").write_text("# no images\n")
    (folder / "points3D.txt").write_text("# no points\n")


@refuse("images that are not among the photos", "gone.png")
def other_images(p: Project) -> None:
    rows = [image_line(k) for k in range(VIEWS)]
    write_text(p, images=[image_line(0, "gone.png"), *rows[1:]])


@refuse("image names that fit two photos each", "x.png")
def ambiguous(p: Project) -> None:
    in_subfolders(p)
    write_text(p, images=[image_line(k, "x.png" if k < 2 else None) for k in range(VIEWS)])


@result(GROUP, "image names with their folders", lambda p: subfolders_are_right(p), stages=STAGES)
def with_folders(p: Project) -> None:
    in_subfolders(p)
    names = ("a/x.png", "b/x.png", "p2.png", "p3.png")
    write_text(p, images=[image_line(k, name) for k, name in enumerate(names)])


def subfolders_are_right(p: Project) -> None:
    rig = load_cameras(p.work / "poses" / "cameras.json")
    turns = {v.name: v.world_to_camera[:3, :3] for v in rig.views}
    turn = pose(1)[:3, :3] @ pose(0)[:3, :3].T
    assert np.abs(turns["b_x"] @ turns["a_x"].T - turn).max() < 1e-4, "photos were exchanged"


for _file in ("cameras", "images", "points3D"):

    @refuse(f"{_file}.txt is missing")
    def without(p: Project, file: str = _file) -> None:
        (write_text(p) / f"{file}.txt").unlink()

    @refuse(f"{_file}.bin cut in the middle")
    def cut_binary(p: Project, file: str = _file) -> None:
        path = write_binary(p) / f"{file}.bin"
        path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])

    @refuse(f"{_file}.bin that claims 2^60 entries")
    def endless(p: Project, file: str = _file) -> None:
        path = write_binary(p) / f"{file}.bin"
        path.write_bytes(struct.pack("<Q", 1 << 60) + path.read_bytes()[8:])


@refuse("words among the numbers of cameras.txt")
def words(p: Project) -> None:
    write_text(p, PINHOLE.replace(str(FOCAL), "long"))


@refuse("another shape than the photos", "not the same shape")
def another_shape(p: Project) -> None:
    write_text(p, f"1 PINHOLE {HEIGHT} {WIDTH} {FOCAL} {FOCAL} {HEIGHT / 2} {WIDTH / 2}")
