"""Cases of names: spaces, quotes, commands, emoji, length; of scenes, folders and photos."""

from __future__ import annotations

import os
from collections.abc import Callable

from benchmarks.corpus.case import message, result
from benchmarks.corpus.photos import shows_the_view
from benchmarks.corpus.project import Project

GROUP = "name"
ODD = {
    "spaces": "my  red chair ",
    "quotes": 'it\'s a "chair"',
    "a command": "$(touch hacked) `touch hacked`; touch hacked &",
    "emoji and umlauts": "Stühle 🪑🎉 椅子",
    "a dash in front": "-rf",
    "percent, braces and stars": "50% {scene} * ? [a]",
    "a backslash": "a\\b",
    "a line break": "a\nb",
    "right-to-left marks": "\u202eriahc",
}


def not_hacked(p: Project) -> None:
    found = list(p.folder.rglob("hacked"))
    assert not found, f"a name was run as a command: {found}"


def photo_called(stem: str) -> Callable[[Project], None]:
    """The first photo and its mask by another name."""

    def spoil(p: Project) -> None:
        (p.images / "p0.png").rename(p.images / f"{stem}.png")
        (p.masks / "p0.png").rename(p.masks / f"{stem}.png")
        cameras = p.cameras()
        cameras["frames"][0]["file_path"] = f"images/{stem}.png"
        p.write_cameras(cameras)

    return spoil


def captured_as(stem: str) -> Callable[[Project], None]:
    def check(p: Project) -> None:
        not_hacked(p)
        shows_the_view(stem)(p)
        assert (p.work / "capture" / "masks" / f"{stem}.png").exists(), "its mask is missing"

    return check


for _kind, _name in ODD.items():
    result(GROUP, f"photo with {_kind}", captured_as(_name))(photo_called(_name))
    result(GROUP, f"scene folder with {_kind}", lambda p: not_hacked(p), photos=_name)(
        lambda p: None
    )

LONG = "x" * 200
result(GROUP, "photo of 200 characters", captured_as(LONG))(photo_called(LONG))


@message(GROUP, "photo of 250 characters", "xxxx", "250 bytes", "shorter")
def too_long(p: Project) -> None:
    photo_called("x" * 246)(p)
    (p.masks / f"{'x' * 246}.png").unlink()


@message(GROUP, "photos below ten folders of long names", "bytes", "shorter")
def deep(p: Project) -> None:
    p.transforms.unlink()
    folder = p.images.joinpath(*["a long name for a folder"] * 10)
    folder.mkdir(parents=True)
    (p.images / "p0.png").rename(folder / "p0.png")


@message(GROUP, "photo whose name is no UTF-8", "UTF-8", "images")
def no_utf8(p: Project) -> None:
    p.transforms.unlink()
    os.rename(p.images / "p0.png", os.fsencode(p.images) + b"/p\xff0.png")
