"""What a method gains or loses between versions, at seeds that neither was judged by.

A step of work is kept where draws that were looked at gain by it, so that these draws owe a part of
their scores to chance (regression to the mean): another version, or other seeds, lose it again.
benchmarks/results/study_seeds/<commit>/<suite> has rows of further seeds by two versions, made by
`python -m benchmarks.study --first-seed 3`.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from benchmarks.markdown import number, pipe_table
from benchmarks.study.intervals import paired
from benchmarks.study.store import SUITE, seeds_in, suite_folder, suite_rows
from benchmarks.study.tables import heading, scene_mean, scenes_in, with_interval
from benchmarks.tables.committed import RESULTS
from pipeline.base.errors import InputError
from pipeline.render.declared import METRICS

SEEDS = RESULTS / "study_seeds"
# methods of which there are rows of both versions at further seeds
COMPARED = ("split_gibbs_draft", "preset_standard")
SHOWN = ("relight_psnr", "relight_psnr_channel", "novel_view_psnr", "light_psnr_log")


def scene_means(data: dict, method: str, key: str) -> dict[str, float]:
    """A score's mean over the draws of each scene that has some."""
    found = {scene: scene_mean(data, scene, method, key) for scene in scenes_in(data)}
    return {scene: value for scene, value in found.items() if value is not None}


def difference(data: dict, less: dict, method: str, key: str) -> tuple[float, float, float]:
    """Mean of a score over the scenes that both have, less that of other rows; with its interval
    over scenes.
    """
    ours, theirs = (scene_means(d, method, key) for d in (data, less))
    both = [scene for scene in ours if scene in theirs]
    return paired(*(np.array([means[scene] for scene in both]) for means in (ours, theirs)))


def scenes_of_all(data: Iterable[dict], method: str) -> list[str]:
    """Scenes that all of these have rows of by the method. Raises InputError where there are
    none.
    """
    of_each = [scene_means(one, method, SHOWN[0]) for one in data]
    scenes = [scene for scene in of_each[0] if all(scene in means for means in of_each)]
    if not scenes:
        raise InputError(
            f"no scene has rows of {method} by both versions and in the study",
            SEEDS,
            "make them: python -m benchmarks.study --first-seed 3 --methods " + method,
        )
    return scenes


def of_scenes(data: dict, scenes: list[str]) -> dict:
    """The rows of some scenes only."""
    return data | {"rows": [row for row in data["rows"] if row["scene"] in scenes]}


def cells(data: dict, method: str, scenes: Iterable[str]) -> list[str]:
    """Means over these scenes."""
    found = [scene_means(data, method, key) for key in SHOWN]
    means = [np.mean([of_scene[scene] for scene in scenes]) for of_scene in found]
    return [number(float(mean), METRICS[key].digits) for mean, key in zip(means, SHOWN)]


def table(method: str, before: str, after: str) -> str:
    """Two versions at further seeds, the later one at the study's, and their differences, of the
    scenes that all three have rows of. Raises InputError where there are none.
    """
    found = [suite_rows(SUITE, SEEDS / commit) for commit in (before, after)] + [suite_rows(SUITE)]
    scenes = scenes_of_all(found, method)
    old, new, study = (of_scenes(data, scenes) for data in found)
    seeds = seeds_in(suite_folder(SEEDS / after, SUITE) / next(iter(scenes)) / method)
    further = f"seeds {seeds[0]} to {seeds[-1]}"
    body = [
        [f"former code ({before}), {further}", *cells(old, method, scenes)],
        [f"later code ({after}), {further}", *cells(new, method, scenes)],
        ["the study's rows, its seeds", *cells(study, method, scenes)],
    ]
    for name, less in (("less the former code", old), ("less the study's rows", study)):
        changes = [difference(new, less, method, key) for key in SHOWN]
        body.append([f"later code, {further}, {name}", *(with_interval(c, 2) for c in changes)])
    return pipe_table([f"`{method}`, {len(scenes)} scenes", *map(heading, SHOWN)], body)


def tables(before: str, after: str) -> str:
    """`table` of every method in COMPARED."""
    return "\n".join(table(method, before, after) for method in COMPARED)
