"""Rows of the study: one method's draws of one scene, in a process of its own.

python -m benchmarks.study.rows --photos SCENE --method split_gibbs_draft --seeds 0 1 2 \\
    --rows FOLDER/rows --draws FOLDER/draws

Writes FOLDER/rows/<scene>/<method>/<seed>.json, and below FOLDER/draws <seed>.npz with the pictures
that figures of several draws together are made of, and <seed>/ with the draw itself where a mean is
made of it. Seeds whose row is there are left alone. One
thread, so that processor seconds are what a draw takes on an idle machine, and peak memory is the
method's own. benchmarks.study is the command that runs it.
"""

from __future__ import annotations

import argparse
import json
import resource
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from benchmarks.stability.chain import fitted
from benchmarks.study.mean_of_draws import mean_of_draws
from benchmarks.study.methods import METHODS, keeps_draws, methods_named, scene_for
from benchmarks.study.store import made_here, row_file
from pipeline.base.config import Scene
from pipeline.base.errors import run_stage
from pipeline.base.files import atomic_path, write_json
from pipeline.base.progress import Bar
from pipeline.base.runtime import rays_made, set_threads
from pipeline.posterior.choose.chosen import Chosen, chosen_scene
from pipeline.posterior.choose.decide import Evidence, choose
from pipeline.posterior.judge import judge
from pipeline.posterior.load import load_problem
from pipeline.posterior.problem import Problem
from pipeline.posterior.refine import refine, units
from pipeline.posterior.samplers import SAMPLERS
from pipeline.prior.load import load_prior
from pipeline.prior.protocol import Prior
from pipeline.render.envmap import resample_area, sh_coefficients
from pipeline.render.renderer import Explanation, Renderer
from pipeline.render.stacking import LeftOut
from pipeline.report.score import MAX_DEPTH, Scored, score_explanation
from pipeline.report.truth import truth_of_work

SPP = 64  # paths per pixel of scored pictures
SH_ROWS = 32


class Clock:
    """Wall and processor seconds, and rays, of what runs inside `with`."""

    def __enter__(self) -> Clock:
        self.began = time.perf_counter(), time.process_time(), rays_made()
        return self

    def __exit__(self, *error: object) -> None:
        wall, processor, rays = self.began
        self.cost = {
            "seconds": round(time.perf_counter() - wall, 3),
            "cpu_seconds": round(time.process_time() - processor, 3),
            "rays": rays_made() - rays,
        }


def light_unknowns(light: np.ndarray) -> np.ndarray:
    """SH coefficients (27,) of a light up to order 2."""
    return sh_coefficients(resample_area(light, SH_ROWS, 2 * SH_ROWS)).ravel()


def drawn(
    method: str, scene: Scene, folders: dict[str, Path], seed: int
) -> tuple[Explanation, LeftOut, dict]:
    """As `draw`, with what a row says it took: its `cost`, and this process's `peak_gib`."""
    final, judged, cost = draw(method, scene, folders, seed)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    return final, judged, {"cost": cost, "peak_gib": round(peak, 2)}


def loader(scene: Scene, folders: dict[str, Path], prior: Prior) -> Callable[[int], Problem]:
    """The scene's problem, for maps of so many texels a side and the prior's light."""
    stages = [folders[name] for name in ("observe", "poses", "atlas", "mesh")]
    return lambda texture: load_problem(*stages, scene, texture, prior.height)


def draw(
    method: str, scene: Scene, folders: dict[str, Path], seed: int
) -> tuple[Explanation, LeftOut, dict]:
    """One refined draw, how it predicts photos left out, and what it cost."""
    prior = load_prior(scene.sample.prior)
    load = loader(scene, folders, prior)
    start = Explanation.load(folders["fit"])
    problem = load(scene.sample.texture)
    sampler = SAMPLERS[METHODS[method].sampler]
    with Clock() as sampling:
        drawn, _ = sampler(problem, prior, start, scene.sample, seed)

    settings = scene.refine
    full = load(settings.texture)
    with Clock() as refining, Bar(f"refine {seed}", units(settings)) as bar:
        final, _ = refine(full, drawn, settings, seed, bar, sampler.scale_drawn)
        judged = judge(full, final, settings)
    return final, judged, {"sample": sampling.cost, "refine": refining.cost}


def settled(scene: Scene, folders: dict[str, Path], own: Path) -> tuple[Scene, dict]:
    """A shipped preset's scene with what the choose stage decides; what this and the fit that comes
    of it cost, once for all draws. The fit is saved in the folder `own`.
    """
    surface = [folders[s] for s in ("observe", "poses", "atlas", "mesh")]
    with Clock() as choosing:
        Chosen(choose(Evidence(*surface), scene)["settings"]).save(own)
        scene = chosen_scene(scene, own)
    with Clock() as fitting:
        fitted(folders, scene, own)
    return scene, {"choose": choosing.cost, "fit": fitting.cost}


def keep_pictures(path: Path, scored: Scored, x: Explanation) -> None:
    """What figures of several draws need."""
    half = {f"picture/{name}": pair.astype(np.float16) for name, pair in scored.pictures.items()}
    with atomic_path(path) as temporary:
        np.savez_compressed(
            temporary,
            albedo=scored.albedo.astype(np.float16),
            log_light=scored.log_light,
            sh=light_unknowns(x.light),
            **half,
        )


def measure(
    method: str,
    photos: Path,
    work: Path,
    seeds: list[int],
    rows: Path,
    draws: Path,
    about: dict | None = None,
    keep: Path | None = None,
) -> None:
    """Write the rows that are not there, rows/<scene>/<method>/<seed>.json, and what figures of
    several draws need, draws/<scene>/<method>/<seed>.npz. about: what every row says of the run
    besides; keep: folder for the draws themselves, keep/<scene>/<method>/<seed>, where they are
    wanted; a mean's draws lie there.
    """
    name = photos.name
    folders = {s: work / name / s for s in ("observe", "poses", "atlas", "mesh", "fit")}
    scene = scene_for(method, str(photos))
    about = about or {}
    if METHODS[method].shipped and not METHODS[method].mean_of:
        folders["fit"] = draws / name / method / "fit"
        folders["fit"].mkdir(parents=True, exist_ok=True)
        scene, once = settled(scene, folders, folders["fit"])
        about = about | {"once": once}
    truth = truth_of_work(photos, work / name)
    height = len(truth.known_light())
    renderer = Renderer(folders["atlas"] / "mesh_uv.ply", scene.refine.texture, height, MAX_DEPTH)

    for seed in seeds:
        file = row_file(rows, name, method, seed)
        if file.exists():
            continue
        if METHODS[method].mean_of:
            assert keep is not None  # where the draws lie
            final, spent = mean_of_draws(METHODS[method].mean_of, keep / name, rows / name)
        else:
            final, judged, spent = drawn(method, scene, folders, seed)
            if keep is not None:
                final.save(keep / name / method / str(seed))
                judged.save(keep / name / method / str(seed))
        scored = score_explanation(renderer, final, truth, SPP)
        keep_pictures(draws / name / method / f"{seed}.npz", scored, final)
        row = {
            "scene": name,
            "method": method,
            "seed": seed,
            **made_here(),
            "scores": scored.values,
            "views": scored.views,
            "white": truth.white,
            **spent,
        }
        write_json(file, about | row)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--photos", type=Path, required=True)
    parser.add_argument("--method", required=True)
    parser.add_argument("--seeds", type=int, nargs="+", required=True)
    parser.add_argument("--work", type=Path, default=Path("work"))
    parser.add_argument("--rows", type=Path, required=True)
    parser.add_argument("--draws", type=Path, required=True)
    parser.add_argument("--about", type=json.loads, default={}, help="what rows say besides, JSON")
    args = parser.parse_args()
    methods_named([args.method])
    set_threads(1)
    uses_draws = METHODS[args.method].mean_of or keeps_draws(args.method)
    measure(
        args.method,
        args.photos,
        args.work,
        args.seeds,
        args.rows,
        args.draws,
        about=args.about,
        keep=args.draws if uses_draws else None,
    )


if __name__ == "__main__":
    run_stage(main)
