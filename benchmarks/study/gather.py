"""Rows of a study, and the figures that several draws have together."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from benchmarks.scenes import machine
from benchmarks.study.rows import light_unknowns
from pipeline.base.errors import InputError
from pipeline.base.files import read_json
from pipeline.base.images import linear_to_srgb
from pipeline.render.draw_metrics import coverage
from pipeline.report.score import Scored, map_truth, score_draws, true_pictures
from pipeline.report.truth import Truth, load_truth

COVERED = 500  # pixels that coverage is taken of, per scene


def gathered(out: Path) -> dict:
    """All rows under `out`/rows, and per scene and method what its draws say together. Raises
    InputError where there is none.
    """
    files = sorted((out / "rows").glob("*/*/*.json"), key=lambda f: (f.parts[-3:-1], int(f.stem)))
    if not files:
        raise InputError("there are no rows", out / "rows", "run the study without --tables first")
    rows = [read_json(file) for file in files]

    together = []
    for scene in dict.fromkeys(row["scene"] for row in rows):
        of_scene = [row for row in rows if row["scene"] == scene]
        truth = truth_of_row(out / "scenes" / scene, of_scene[0])
        for method in dict.fromkeys(row["method"] for row in of_scene):
            seeds = [row["seed"] for row in of_scene if row["method"] == method]
            packs = [np.load(out / "rows" / scene / method / f"{seed}.npz") for seed in seeds]
            if len(packs) > 1:
                scores = of_draws(packs, truth)
                together.append({"scene": scene, "method": method, "scores": scores})
    return {"machine": machine(), "rows": rows, "together": together}


def truth_of_row(folder: Path, row: dict) -> Truth:
    """The truth of a scene's folder in the unit that a row's pictures have."""
    # an earlier version's row has none: its truth was in the unit of the held-out views
    return load_truth(folder, row.get("white"))


def of_draws(packs: list, truth: Truth) -> dict:
    """Scores of several draws, and under "coverage" the share of true values that their intervals
    hold, by kind of unknown.
    """
    draws = [
        Scored(
            {},
            {},
            {k[8:]: pack[k].astype(np.float32) for k in pack.files if k.startswith("picture/")},
            pack["albedo"].astype(np.float64),
            pack["log_light"],
        )
        for pack in packs
    ]
    relit, true_relit = some_pixels(draws, truth)
    held = {
        "light": coverage(
            np.array([pack["sh"] for pack in packs]), light_unknowns(truth.known_light())
        ),
        "relit": coverage(relit, true_relit),
    }
    known = map_truth(truth)
    if "albedo" in known:
        some = np.random.default_rng(0).permutation(len(known["albedo"]))[:COVERED]
        colors = np.array([draw.albedo[some].ravel() for draw in draws])
        held["albedo"] = coverage(colors, known["albedo"][some].ravel())
    return score_draws(draws, truth) | {"coverage": held}


def some_pixels(draws: list[Scored], truth: Truth) -> tuple[np.ndarray, np.ndarray]:
    """sRGB values of random relit pixels: of the draws (n, k), and true (k,)."""
    rng = np.random.default_rng(0)
    ours: list[list[np.ndarray]] = [[] for _ in draws]
    theirs = []
    true = {n: v for n, v in true_pictures(truth).items() if n.startswith("relight/")}
    for name, (known, shown, _) in true.items():
        inside = np.argwhere(known.mask)
        rows, columns = rng.permutation(inside)[: COVERED // len(true)].T
        theirs.append(linear_to_srgb(shown.mean[rows, columns]).ravel())
        for parts, draw in zip(ours, draws):
            mean = draw.pictures[name].mean(0)[rows, columns]
            parts.append(linear_to_srgb(mean).ravel())
    return np.array([np.concatenate(parts) for parts in ours]), np.concatenate(theirs)
