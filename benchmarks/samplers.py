"""Samplers side by side on scenes whose light and base colour are known.

python -m benchmarks.samplers --scene boombox FOLDER --methods split_gibbs dpi_paper --samples 2 --out rows.json

FOLDER is a scene rendered by the project's scene maker (images/, transforms*.json, mesh.ply, truth/); work/<scene> holds
its stages up to `fit` (run `snakemake work/<scene>/fit/fit.json` first). One process, one thread per sampler as in the
sample stage; every draw is refined with refine.steps = 0 (base colour only), so that the methods' own roughness and
metallic are judged. Per method: seconds per draw, light PSNR (log radiance, one common scale removed), PSNR of held-out
views inside the mask, base colour error (RMS over held-out views, raw and after one factor per channel), and how often
the 80 % interval of the draws holds the true SH light coefficients (order 2), which says little for few draws.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import time
from pathlib import Path

import numpy as np

from pipeline.config import load_scene
from pipeline.envmap import resample_area, sh_coefficients
from pipeline.files import write_json
from pipeline.images import read_exr
from pipeline.metrics import light_psnr, score_held_out
from pipeline.observe import Tracer
from pipeline.optics import Explanation
from pipeline.posterior import SAMPLERS
from pipeline.posterior.load import load_problem
from pipeline.posterior.refine import COARSE, gather, refine
from pipeline.prior import load_prior
from pipeline.runtime import set_threads


def base_colour_error(x: Explanation, problem, mesh: Path, truth: Path) -> tuple[float, float]:
    """RMS against truth/albedo/<view>.exr over held-out views: raw, and after a least-squares factor per channel."""
    tracer, ours, theirs = Tracer(mesh), [], []
    for view in problem.observations.held_out:
        file = truth / "albedo" / f"{view.name}.exr"
        if not file.exists():
            continue
        picture = read_exr(file)
        rows, columns = np.mgrid[0:view.height:2, 0:view.width:2].reshape(2, -1)
        uv, _, hit = tracer.hit(*view.rays(np.stack([columns + 0.5, rows + 0.5], -1)))
        k = (picture.shape[0] / view.height, picture.shape[1] / view.width)
        value = picture[(rows * k[0]).astype(int), (columns * k[1]).astype(int)]
        hit &= value.max(-1) > 0
        ours.append(gather(x.base_color, uv[hit]))
        theirs.append(value[hit])
    a, b = np.concatenate(ours), np.concatenate(theirs)
    rms = lambda e: float(np.sqrt((e**2).mean()))
    return rms(a - b), rms(a * ((a * b).sum(0) / np.maximum((a * a).sum(0), 1e-12)) - b)


def judge(method: str, scene, folders: dict, folder: Path, samples: int) -> dict:
    """One method on one scene."""
    prior, rows, coefficients = load_prior(scene.sample.prior), [], []
    truth = resample_area(read_exr(folder / "truth" / "envmap.exr"), prior.height, prior.width)
    stages = (folders["observe"], folders["poses"], folders["atlas"])
    settings = scene.refine.model_copy(update={"steps": 0})
    for seed in range(samples):
        problem = load_problem(*stages, scene, scene.sample.texture, prior.height)
        set_threads(1)
        began = time.perf_counter()
        drawn, facts = SAMPLERS[method](problem, prior, Explanation.load(folders["fit"]), scene.sample, seed)
        seconds = time.perf_counter() - began
        set_threads(2)
        full = load_problem(*stages, scene, settings.texture, prior.height)
        small = load_problem(*stages, scene, min(COARSE, settings.texture), prior.height)
        final, _ = refine(full, small, drawn, settings, seed, rescale=not facts.get("scale_drawn", False))
        raw, aligned = base_colour_error(final, full, folders["atlas"] / "mesh_uv.ply", folder / "truth")
        held_out = score_held_out(full, final, folders["poses"], folders["mesh"], scene.observe.erode, 64)["held_out_psnr"]
        coefficients.append(sh_coefficients(final.light))
        rows.append([seconds, light_psnr(final.light, truth), held_out, raw, aligned])
    low, high = np.quantile(coefficients, [0.1, 0.9], axis=0)
    inside = (sh_coefficients(truth) >= low) & (sh_coefficients(truth) <= high)
    names = ("seconds", "light_psnr", "held_out_psnr", "base_colour_rms", "base_colour_rms_aligned")
    return {"method": method} | dict(zip(names, np.mean(rows, 0).round(4).tolist())) | {"sh_covered": float(inside.mean()), "samples": samples}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", nargs=2, action="append", metavar=("NAME", "FOLDER"), required=True)
    parser.add_argument("--methods", nargs="+", default=["split_gibbs", "gaussian", "dpi_paper", "dpi_code", "sds", "map"])
    parser.add_argument("--samples", type=int, default=2)
    parser.add_argument("--work", type=Path, default=Path("work"))
    parser.add_argument("--set", nargs="*", default=[], help="settings as section.key=value")
    parser.add_argument("--out", type=Path)
    args = parser.parse_args()
    from pipeline.stage import overrides
    rows = []
    for name, folder in args.scene:
        scene = load_scene(Path("configs") / f"{name}.yaml", overrides(args.set))
        folders = {s: args.work / name / s for s in ("observe", "poses", "atlas", "mesh", "fit")}
        for method in args.methods:
            rows.append({"scene": name} | judge(method, scene, folders, Path(folder), args.samples))
            print(json.dumps(rows[-1]), flush=True)
    if args.out:
        write_json(args.out, {"machine": f"{platform.machine()}, {os.cpu_count()} cores", "rows": rows})


if __name__ == "__main__":
    main()
