"""Figures that several draws of a scene and method have together."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from numpy.lib.npyio import NpzFile

from benchmarks.study.methods import MEANT, METHODS
from benchmarks.study.rows import light_unknowns
from benchmarks.study.store import TOGETHER, made_here, seeds_in
from pipeline.base.files import read_json, write_json
from pipeline.base.images import linear_to_srgb
from pipeline.render.draw_metrics import coverage, held_within
from pipeline.report.score import Scored, map_truth, score_draws, true_pictures
from pipeline.report.truth import Truth, load_truth

COVERED = 500  # pixels that coverage is taken of, per scene
COMMON = (0.0, 0.01, 0.02, 0.03, 0.04)  # errors that all draws may share, sRGB


def join(scene: Path, method: str, rows: Path, draws: Path, about: dict) -> None:
    """Write what all draws of a scene's folder and a method say together, where that is not there
    or is of other draws; of a mean, what its draws' intervals about it hold. about: what the row
    says of the run besides.

    Pictures of draws are not committed. Where those of a row lie on another machine, what is there
    stays, and a line on stderr says so.
    """
    place = rows / scene.name / method
    file = place / TOGETHER
    mean_of = METHODS[method].mean_of
    own = seeds_in(place)
    seeds = list(range(MEANT)) if mean_of and own else own
    if len(seeds) < 2 or (file.exists() and read_json(file)["seeds"] == seeds):
        return

    packs = [draws / scene.name / (mean_of or method) / f"{seed}.npz" for seed in seeds]
    means = [draws / scene.name / method / f"{seed}.npz" for seed in own] if mean_of else []
    missing = [pack for pack in (*packs, *means) if not pack.exists()]
    if missing:
        said = f"{scene.name}, {method}: draws are not joined, there is no {missing[0]}"
        print(said, file=sys.stderr, flush=True)
        return
    truth = truth_of_row(scene, read_json(place / f"{own[0]}.json"))
    loaded = [np.load(pack) for pack in packs]
    scores = of_mean(np.load(means[0]), loaded, truth) if means else of_draws(loaded, truth)
    row = {"scene": scene.name, "method": method, "seeds": seeds, **made_here(), "scores": scores}
    write_json(file, about | row)


def truth_of_row(folder: Path, row: dict) -> Truth:
    """The truth of a scene's folder in the unit that a row's pictures have."""
    # an earlier version's row has none: its truth was in the unit of the held-out views
    return load_truth(folder, row.get("white"))


def of_draws(packs: list[NpzFile], truth: Truth) -> dict:
    """Scores of several draws; under "coverage" the share of true values that their intervals
    hold, by kind of unknown; under "within" what intervals of sRGB values hold that count an error
    all draws have in common, for each of COMMON.
    """
    draws = [scored(pack) for pack in packs]
    relit, true_relit = some_pixels(draws, truth)
    held = {
        "light": coverage(
            np.array([pack["sh"] for pack in packs]), light_unknowns(truth.known_light())
        ),
        "relit": coverage(relit, true_relit),
    }
    within = {"relit": by_common_error(relit, true_relit)}
    if "albedo" in map_truth(truth):
        colors, true_colors = some_colors(draws, truth)
        held["albedo"] = coverage(colors, true_colors)
        within["albedo"] = by_common_error(linear_to_srgb(colors), linear_to_srgb(true_colors))
    return score_draws(draws, truth) | {"coverage": held, "within": within}


def of_mean(mean: NpzFile, packs: list[NpzFile], truth: Truth) -> dict:
    """As `of_draws`, of intervals of the draws' width about their mean: "within" alone."""
    *draws, middle = [scored(pack) for pack in (*packs, mean)]
    relit, true_relit = some_pixels([*draws, middle], truth)
    within = {"relit": by_common_error(relit[:-1], true_relit, relit[-1])}
    if "albedo" in map_truth(truth):
        colors, true_colors = some_colors([*draws, middle], truth)
        *apart, about = linear_to_srgb(colors)
        srgb = linear_to_srgb(true_colors)
        within["albedo"] = by_common_error(np.array(apart), srgb, about)
    return {"within": within}


def scored(pack: NpzFile) -> Scored:
    """What `rows.keep_pictures` kept of a draw, without its scores."""
    pictures = [name for name in pack.files if name.startswith("picture/")]
    return Scored(
        {},
        {},
        {name.removeprefix("picture/"): pack[name].astype(np.float32) for name in pictures},
        pack["albedo"].astype(np.float64),
        pack["log_light"],
    )


def by_common_error(
    draws: np.ndarray, truth: np.ndarray, about: np.ndarray | None = None
) -> dict[str, dict[str, float]]:
    """What intervals of draws (n, k) hold of truth (k,), for each of COMMON; about: as in
    `held_within`.
    """
    return {str(common): held_within(draws, truth, common, about) for common in COMMON}


def some_colors(draws: list[Scored], truth: Truth) -> tuple[np.ndarray, np.ndarray]:
    """Linear base colours at random true pixels: of the draws (n, k), and true (k,)."""
    known = map_truth(truth)["albedo"]
    some = np.random.default_rng(0).permutation(len(known))[:COVERED]
    return np.array([draw.albedo[some].ravel() for draw in draws]), known[some].ravel()


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
