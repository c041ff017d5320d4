"""The points of the suite's curves from the rows at hand."""

from __future__ import annotations

from itertools import takewhile
from pathlib import Path

import numpy as np

from benchmarks.scenes import machine
from benchmarks.stability.knobs import KNOBS
from benchmarks.stability.point import REFUSED, seeds_of
from benchmarks.stability.points import Point
from benchmarks.stability.scenes import BASES, SIZES
from benchmarks.study.methods import METHODS
from benchmarks.study.together import of_draws, truth_of_row
from pipeline.base.errors import InputError
from pipeline.base.files import read_json

KEPT = (
    "relight_psnr",
    "relight_psnr_channel",
    "light_psnr_log",
    "albedo_mse",
    "albedo_mse_channel",
    "roughness_mse",
    "metallic_mse",
)
LEAST_DRAWS = 3  # that coverage is taken of


def gathered(out: Path) -> dict:
    """All points whose rows are there. Raises InputError where there is none."""
    found = []
    for size in SIZES:
        for base in BASES:
            for name, knob in KNOBS.items():
                for value in knob.values:
                    for method in METHODS:
                        point = Point(size, base, name, value)
                        found += of_point(point, method, out)
    if not found:
        raise InputError("there are no rows", out / "rows", "run the suite without --gather first")
    return {"machine": machine(), "rows": found}


def of_point(point: Point, method: str, out: Path) -> list[dict]:
    """What a method's draws say at a point, in a list: of draws up to the first that is missing.
    Empty where there is none, or where the knob counts draws and not all are there.
    """
    of_the_run = KNOBS[point.knob].of_the_run
    if of_the_run and not METHODS[method].drawn:
        return []
    rows = out / "rows" / point.scene / method
    about = {"size": point.size, "base": point.base, "knob": point.knob, "value": point.value}
    about |= {"method": method}
    if (rows / REFUSED).exists():
        return [about | {"refused": read_json(rows / REFUSED)["refused"]}]
    wanted = seeds_of(point, method)
    seeds = list(takewhile(lambda seed: (rows / f"{seed}.json").exists(), wanted))
    if not seeds or (of_the_run and seeds != wanted):
        return []
    found = [read_json(rows / f"{seed}.json") for seed in seeds]
    mean = {key: float(np.mean([row["scores"][key] for row in found])) for key in KEPT}
    each = [row["scores"]["relight_psnr"] for row in found]
    cost = [
        row["cost"]["sample"]["cpu_seconds"] + row["cost"]["refine"]["cpu_seconds"] for row in found
    ]
    more = {"draws": len(seeds), "relight_each": each, "seconds": float(np.mean(cost))}
    more["commits"] = sorted({row["commit"] for row in found})
    if len(seeds) >= LEAST_DRAWS:
        packs = [np.load(rows / f"{seed}.npz") for seed in seeds]
        together = of_draws(packs, truth_of_row(out / "scenes" / point.scene, found[0]))
        held = {kind: shares["80%"] for kind, shares in together["coverage"].items()}
        more |= {"held": held, "coverage": float(np.mean(list(held.values())))}
        more["relight_of_mean"] = together["relight_psnr_of_mean"]
    return [about | {"scores": mean} | more]
