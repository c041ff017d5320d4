"""The yardsticks beside the study's methods."""

from __future__ import annotations

from benchmarks.markdown import number, pipe_table
from benchmarks.study.methods import YARDSTICKS
from benchmarks.study.tables import mean_of, methods_in, scene_mean, scenes_in
from benchmarks.tables.committed import title

COLUMNS = (
    ("relight PSNR, dB", "relight_psnr"),
    ("relight PSNR, aligned, dB", "relight_psnr_channel"),
    ("novel-view PSNR, dB", "novel_view_psnr"),
)


def means(data: dict, key: str = "relight_psnr") -> dict[str, float]:
    """Each yardstick's score, mean over the study's scenes; of those that have rows of all."""
    found = {name: mean_of(data, name, key) for name in YARDSTICKS}
    return {name: value for name, value in found.items() if value is not None}


def beaten_by(data: dict, name: str) -> dict[str, list[str]]:
    """Methods that relight worse than a yardstick, by scene."""
    behind = {}
    for scene in scenes_in(data):
        found = {m: scene_mean(data, scene, m, "relight_psnr") for m in [name, *methods_in(data)]}
        least = found.pop(name)
        behind[scene] = [m for m, mine in found.items() if mine is not None and mine < least]
    return behind


def table(data: dict) -> str:
    """Means over the study's scenes of each yardstick, and how many rows of methods it beats."""
    columns = [means(data, key) for _, key in COLUMNS]
    body = []
    for name in YARDSTICKS:
        beaten = sum(map(len, beaten_by(data, name).values()))
        body.append([f"`{name}`", *(number(column[name], 1) for column in columns), str(beaten)])
    heads = [head for head, _ in COLUMNS]
    return pipe_table(["yardstick", *heads, "methods and scenes behind it"], body)


def losers(data: dict) -> str:
    """Who relights worse than a yardstick, in one sentence for each."""
    said = []
    for name in YARDSTICKS:
        found = [
            f"on {title(scene)} {', '.join(f'`{method}`' for method in methods)}"
            for scene, methods in beaten_by(data, name).items()
            if methods
        ]
        said.append(f"Behind `{name}`: {'; '.join(found) if found else 'none'}.")
    return "\n\n".join(said) + "\n"
