"""The yardsticks beside the study's methods."""

from __future__ import annotations

import numpy as np

from benchmarks.markdown import number, pipe_table
from benchmarks.study.tables import methods_in, scene_mean, scenes_in
from benchmarks.study.yardsticks import YARDSTICKS

COLUMNS = (
    ("relight PSNR, dB", "relight_psnr"),
    ("relight PSNR, aligned, dB", "relight_psnr_channel"),
    ("novel-view PSNR, dB", "novel_view_psnr"),
)


def value(rows: list[dict], scene: str, name: str, key: str) -> float:
    """A yardstick's score of a scene."""
    (found,) = [row for row in rows if (row["scene"], row["yardstick"]) == (scene, name)]
    return found["scores"][key]


def means(data: dict, rows: list[dict], key: str = "relight_psnr") -> dict[str, float]:
    """Each yardstick's score, mean over the study's scenes."""
    scenes = scenes_in(data)
    return {
        name: float(np.mean([value(rows, s, name, key) for s in scenes])) for name in YARDSTICKS
    }


def beaten_by(data: dict, rows: list[dict], name: str) -> list[str]:
    """Methods, with their scenes, that relight worse than a yardstick."""
    return [
        f"`{method}` on {scene.replace('__', ', ')}"
        for method in methods_in(data)
        for scene in scenes_in(data)
        if (mine := scene_mean(data, scene, method, "relight_psnr")) is not None
        and mine < value(rows, scene, name, "relight_psnr")
    ]


def table(data: dict, rows: list[dict]) -> str:
    """Means over the study's scenes of each yardstick, and how many rows of methods it beats."""
    columns = [means(data, rows, key) for _, key in COLUMNS]
    body = []
    for name in YARDSTICKS:
        beaten = len(beaten_by(data, rows, name))
        body.append([f"`{name}`", *(number(column[name], 1) for column in columns), str(beaten)])
    heads = [head for head, _ in COLUMNS]
    return pipe_table(["yardstick", *heads, "methods and scenes behind it"], body)


def losers(data: dict, rows: list[dict]) -> str:
    """Who relights worse than a yardstick, in one sentence for each."""
    said = []
    for name in YARDSTICKS:
        found = beaten_by(data, rows, name)
        said.append(f"Behind `{name}`: {', '.join(found) if found else 'none'}.")
    return "\n\n".join(said) + "\n"
