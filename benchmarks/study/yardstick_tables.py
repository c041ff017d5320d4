"""The yardsticks beside the study's methods."""

from __future__ import annotations

import numpy as np

from benchmarks.markdown import number, pipe_table
from benchmarks.study.tables import methods_in, scene_mean, scenes_in
from benchmarks.study.yardsticks import YARDSTICKS
from benchmarks.tables.committed import title

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


def beaten_by(data: dict, rows: list[dict], name: str) -> dict[str, list[str]]:
    """Methods that relight worse than a yardstick, by scene."""
    behind = {}
    for scene in scenes_in(data):
        least = value(rows, scene, name, "relight_psnr")
        found = [(m, scene_mean(data, scene, m, "relight_psnr")) for m in methods_in(data)]
        behind[scene] = [method for method, mine in found if mine is not None and mine < least]
    return behind


def table(data: dict, rows: list[dict]) -> str:
    """Means over the study's scenes of each yardstick, and how many rows of methods it beats."""
    columns = [means(data, rows, key) for _, key in COLUMNS]
    body = []
    for name in YARDSTICKS:
        beaten = sum(map(len, beaten_by(data, rows, name).values()))
        body.append([f"`{name}`", *(number(column[name], 1) for column in columns), str(beaten)])
    heads = [head for head, _ in COLUMNS]
    return pipe_table(["yardstick", *heads, "methods and scenes behind it"], body)


def losers(data: dict, rows: list[dict]) -> str:
    """Who relights worse than a yardstick, in one sentence for each."""
    said = []
    for name in YARDSTICKS:
        found = [
            f"on {title(scene)} {', '.join(f'`{method}`' for method in methods)}"
            for scene, methods in beaten_by(data, rows, name).items()
            if methods
        ]
        said.append(f"Behind `{name}`: {'; '.join(found) if found else 'none'}.")
    return "\n\n".join(said) + "\n"
