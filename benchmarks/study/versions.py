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


def cells(data: dict, method: str, scenes: Iterable[str]) -> list[str]:
    """Means over these scenes."""
    found = [scene_means(data, method, key) for key in SHOWN]
    means = [np.mean([of_scene[scene] for scene in scenes]) for of_scene in found]
    return [number(float(mean), METRICS[key].digits) for mean, key in zip(means, SHOWN)]


def table(method: str, before: str, after: str) -> str:
    """Two versions at further seeds, the later one at the study's, and their differences."""
    old, new = (suite_rows(SUITE, SEEDS / commit) for commit in (before, after))
    study = suite_rows(SUITE)
    scenes = scene_means(new, method, SHOWN[0])
    seeds = seeds_in(suite_folder(SEEDS / after, SUITE) / next(iter(scenes)) / method)
    further = f"seeds {seeds[0]} to {seeds[-1]}"
    body = [
        [f"former code ({before}), {further}", *cells(old, method, scenes)],
        [f"today's ({after}), {further}", *cells(new, method, scenes)],
        ["today's, the study's seeds", *cells(study, method, scenes)],
    ]
    for name, less in (("less the former code", old), ("less the study's seeds", study)):
        found = [difference(new, less, method, key) for key in SHOWN]
        body.append([f"today's, {further}, {name}", *(with_interval(f, 2) for f in found)])
    return pipe_table([f"`{method}`, {len(scenes)} scenes", *map(heading, SHOWN)], body)


def tables(before: str, after: str) -> str:
    """`table` of every method in COMPARED."""
    return "\n".join(table(method, before, after) for method in COMPARED)
