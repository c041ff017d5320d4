"""Writes what a layout's reader found as a scene folder with truth/ (docs/scene_folder.md)."""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path

import numpy as np
from PIL import Image

from benchmarks.layouts.content import LEAST_PHOTOS, OWN_FILE, Content, Relit, Shot
from benchmarks.layouts.pictures import load, load_albedo
from pipeline.base.errors import InputError
from pipeline.base.files import report_metrics, stage_folder, write_json
from pipeline.base.images import to_srgb8, write_exr
from pipeline.base.progress import progress

MARK = "truth/layout.json"
NAME = re.compile(r"\w[\w .+-]*")  # of a file, in no other folder


def frame(shot: Shot, file: str, width: int, height: int) -> dict:
    """A frame of transforms.json: square pixels, the axis through the middle."""
    focal = float(0.5 * width / np.tan(0.5 * shot.angle))
    return {
        "file_path": file,
        "transform_matrix": shot.pose.tolist(),
        "w": width,
        "h": height,
        "fl_x": focal,
        "fl_y": focal,
        "cx": width / 2,
        "cy": height / 2,
    }


def write_mask(file: Path, outline: np.ndarray) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray((outline * 255).astype(np.uint8)).save(file)


def write_photos(folder: Path, shots: list[Shot], side: int | None, file: str, label: str) -> None:
    """images/, masks/ and the cameras of a split: EXR photos as EXR, others as 8-bit PNG."""
    (folder / "images").mkdir(exist_ok=True)
    frames = []
    for shot in progress(shots, label):
        linear, outline = load(shot, side)
        kind = "exr" if shot.photo.suffix.lower() == ".exr" else "png"
        image = f"images/{shot.name}.{kind}"
        if kind == "exr":
            write_exr(folder / image, linear)
        else:
            Image.fromarray(to_srgb8(linear)).save(folder / image)
        write_mask(folder / "masks" / f"{shot.name}.png", outline)
        frames.append(frame(shot, image, outline.shape[1], outline.shape[0]))
    write_json(folder / file, {"frames": frames})


def write_truth(folder: Path, shots: list[Shot], side: int | None) -> None:
    """truth/linear and, where the set has it, truth/albedo of the held-out views."""
    for shot in progress(shots, "truth"):
        linear, outline = load(shot, side, shot.radiance)
        write_exr(folder / "truth" / "linear" / f"{shot.name}.exr", linear)
        if shot.albedo is not None:
            albedo = load_albedo(shot, (outline.shape[1], outline.shape[0]))
            write_exr(folder / "truth" / "albedo" / f"{shot.name}.exr", albedo)


def write_relit(folder: Path, relit: Relit, side: int | None) -> None:
    """A light and the views under it; for views of its own their cameras and masks too."""
    below = f"truth/relight/{relit.name}"
    write_exr(folder / f"{below}.exr", relit.light())
    frames = []
    for shot in progress(relit.shots, f"under {relit.name}"):
        linear, outline = load(shot, side, shot.radiance)
        write_exr(folder / below / f"{shot.name}.exr", linear)
        if relit.own:
            write_mask(folder / below / "masks" / f"{shot.name}.png", outline)
            frames.append(frame(shot, f"{below}/{shot.name}.exr", *linear.shape[1::-1]))
    if relit.own:
        write_json(folder / below / "transforms.json", {"frames": frames})


def check(content: Content) -> None:
    """InputError for too few views, and for views or lights whose names are no files' names of
    their own: they come from the set's files, and name what is written.
    """
    if len(content.train) < LEAST_PHOTOS:
        raise InputError(
            f"{len(content.train)} photos to fit, at least {LEAST_PHOTOS} are needed",
            "--train",
            "ask for more, or use the whole set",
        )
    views = [shot.name for shot in content.train + content.test]
    for kind, names in (("view", views), ("light", [relit.name for relit in content.relights])):
        for name, count in Counter(names).items():
            if count > 1 or not NAME.fullmatch(name):
                fault = f"{count} of them have it" if count > 1 else "it cannot be a file's"
                raise InputError(f"the name of a {kind}, {name!r}: {fault}", "--from", OWN_FILE)


def write_scene(layout: str, content: Content, out: Path, side: int | None = None) -> dict:
    """Write the scene folder `out`, and say what is in it in truth/layout.json, whose notes
    `heliograph score` repeats. Raises InputError as `check` does, and for a picture that cannot be
    read, or an `out` that holds something else.
    """
    check(content)
    about = {
        "layout": layout,
        "photos": len(content.train),
        "held_out": len(content.test),
        "albedo": all(shot.albedo is not None for shot in content.test),
        "light": content.light is not None,
        "relights": [relit.name for relit in content.relights],
        "notes": content.notes,
    }
    with stage_folder(out, MARK) as folder:
        write_photos(folder, content.train, side, "transforms.json", "photos")
        write_photos(folder, content.test, side, "transforms_test.json", "held-out views")
        write_truth(folder, content.test, side)
        if content.light is not None:
            write_exr(folder / "truth" / "envmap.exr", content.light())
        for relit in content.relights:
            write_relit(folder, relit, side)
        report_metrics(folder / MARK, about)
    return about
