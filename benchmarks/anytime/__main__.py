"""Anytime curves: what a run would be worth if it were stopped early.

python -m benchmarks.anytime --suite S --scenes NAMES --out STUDY                    # runs
python -m benchmarks.anytime --suite S --scenes NAMES --out STUDY --gather rows.json

STUDY is a folder of benchmarks.study: scenes/ and, beside them, anytime/<scene>/<method>.json, one
file a run; what is there is not made again. At some of a run's stops (stops.py) what it would
return is refined and scored as a whole draw is. Its seconds are processor seconds of the run up to
there, without those of the stops before it, and of its refinement.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path

from benchmarks.anytime.stops import RUNS, Run
from benchmarks.chain_runs import rows_at_hand
from benchmarks.scenes import ROOT
from benchmarks.study.__main__ import prepare
from benchmarks.study.methods import METHODS, scene_for
from benchmarks.study.rows import SPP, Clock, loader
from benchmarks.study.scenes import scenes_of
from benchmarks.study.store import made_here
from pipeline.base.config import Scene
from pipeline.base.errors import InputError, nearest, run_stage
from pipeline.base.files import write_json
from pipeline.base.progress import Bar, progress
from pipeline.base.runtime import set_threads
from pipeline.posterior.problem import Problem
from pipeline.posterior.refine import refine, units
from pipeline.posterior.samplers import SAMPLERS
from pipeline.prior.load import load_prior
from pipeline.render.renderer import Explanation, Renderer
from pipeline.report.score import MAX_DEPTH, score_explanation
from pipeline.report.truth import Truth, truth_of_work

SHARES = (1 / 16, 1 / 8, 1 / 4, 3 / 8, 1 / 2, 3 / 4, 1)  # of a run's stops, at which it is scored
KEPT = ("relight_psnr", "novel_view_psnr", "light_psnr_log", "albedo_mse")
SEED = 0
DEFAULT = ("split_gibbs_draft", "split_gibbs_standard", "dpi_paper", "dpi_paper_1000")


def scored_stops(count: int) -> list[int]:
    """Numbers, from 1, of the stops that are scored."""
    return sorted({math.ceil(share * count) for share in SHARES})


class Judge:
    """Refines what a stop returns, and scores it."""

    def __init__(self, scene: Scene, full: Problem, renderer: Renderer, truth: Truth, scale: bool):
        self.scene, self.full, self.renderer, self.truth = scene, full, renderer, truth
        self.scale_drawn = scale

    def __call__(self, x: Explanation) -> tuple[dict, float]:
        """Scores, and what refinement took, processor seconds."""
        settings = self.scene.refine
        with Clock() as refining, Bar("refine", units(settings)) as bar:
            final, _ = refine(self.full, x, settings, SEED, bar, self.scale_drawn)
        scores = score_explanation(self.renderer, final, self.truth, SPP).values
        return {name: scores[name] for name in KEPT}, refining.cost["cpu_seconds"]


def curve(run: Run, judge: Judge) -> list[dict]:
    """Of every scored stop: `stop` of `count`, its `cpu_seconds` in all, `scores`."""
    found, spent, due = [], 0.0, scored_stops(run.count)
    number = 0
    while number < run.count:
        with Clock() as going:
            stop = next(run.stops)
        number += 1
        spent += going.cost["cpu_seconds"]
        if number not in due:
            continue
        with Clock() as ending:
            x = stop()
        scores, refined = judge(x)
        seconds = round(spent + ending.cost["cpu_seconds"] + refined, 2)
        found.append({"stop": number, "count": run.count, "cpu_seconds": seconds, "scores": scores})
    return found


def row(folder: Path, method: str) -> dict:
    """The curve of one run of a method on a scene."""
    work = ROOT / "work" / folder.name
    folders = {s: work / s for s in ("observe", "poses", "atlas", "mesh", "fit")}
    scene = scene_for(method, str(folder))
    prior = load_prior(scene.sample.prior)
    load = loader(scene, folders, prior)
    truth = truth_of_work(folder, work)
    height = len(truth.known_light())
    renderer = Renderer(folders["atlas"] / "mesh_uv.ply", scene.refine.texture, height, MAX_DEPTH)

    name = METHODS[method].sampler
    judge = Judge(scene, load(scene.refine.texture), renderer, truth, SAMPLERS[name].scale_drawn)
    fit = Explanation.load(folders["fit"])
    run = RUNS[name](load(scene.sample.texture), prior, fit, scene.sample, SEED)
    about = {"scene": folder.name, "method": method, "seed": SEED, **made_here()}
    return about | {"stops": curve(run, judge)}


def with_stops(names: list[str]) -> list[str]:
    """The names, where all are methods whose runs may be stopped. Raises InputError."""
    known = [name for name, method in METHODS.items() if method.sampler in RUNS]
    known = [name for name in known if not (METHODS[name].shipped or METHODS[name].mean_of)]
    for name in names:
        if name not in known:
            fact = f"there is no method '{name}' whose runs may be stopped"
            raise InputError(fact, "--methods", nearest(name, known))
    return names


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--suite", default="XS")
    parser.add_argument("--scenes", help="names, with commas between; all if not given")
    parser.add_argument("--methods", default=",".join(DEFAULT), help="names, with commas between")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--gather", type=Path, help="run nothing; JSON file for all rows")
    args = parser.parse_args()
    rows = args.out / "anytime"
    if args.gather:
        write_json(args.gather, rows_at_hand(sorted(rows.glob("*/*.json")), rows))
        return

    methods = with_stops(args.methods.split(","))
    only = args.scenes.split(",") if args.scenes else None
    scenes = scenes_of(args.suite, args.out / "scenes", only=only)
    for folder in scenes:
        prepare(folder)
    set_threads(1)
    file = lambda folder, method: rows / folder.name / f"{method}.json"
    due = [(f, m) for f in scenes for m in methods if not file(f, m).exists()]
    for folder, method in progress(due, "anytime"):
        write_json(file(folder, method), row(folder, method))


if __name__ == "__main__":
    run_stage(main)
