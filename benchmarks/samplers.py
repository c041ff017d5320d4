"""Samplers side by side on scenes whose light and base colour are known.

python -m benchmarks.samplers --scene boombox FOLDER --methods split_gibbs dpi_paper \\
    --samples 2 --out rows.json

FOLDER is a scene of benchmarks.make_scene (images/, transforms*.json, mesh.ply, truth/ with a
relight); work/<scene> holds its stages up to `fit`. benchmarks.pairs makes both. One process, one
thread per sampler as in the sample stage; every draw is refined with refine.steps = 0 (base colour
only), so that the methods' own roughness and metallic are judged. Set OMP_NUM_THREADS=1 as the
workflow does. Per method:

  seconds per draw;
  light PSNR of the draws and of their mean: log radiance, one common scale removed. Where the
    spread is right, the mean is up to 3 dB better than a draw;
  PSNR of held-out views inside the mask, of the draws and of their mean picture;
  base colour error: RMS over held-out views, raw and after one factor per channel;
  PSNR of held-out views under another light;
  roughness: median |log(drawn / true)| over held-out views, and the same with its sign; metallic:
    share of their surface that is on its right side of one half, and mean distance from the truth;
  for 3 draws or more, how often the draws' intervals hold the truth (`Truth.unknowns`).

A folder whose cameras are not given, or without truth/, has seconds and held-out views only.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import resource
import time
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from pipeline.base.config import parse_scene
from pipeline.base.errors import run_stage
from pipeline.base.files import write_json
from pipeline.base.images import read_exr
from pipeline.base.progress import Bar
from pipeline.base.runtime import set_threads
from pipeline.photos.radiance import Radiance
from pipeline.posterior.load import load_problem
from pipeline.posterior.refine import refine, units
from pipeline.posterior.samplers import SAMPLERS
from pipeline.posterior.split_gibbs.regions import group
from pipeline.posterior.textures import gather
from pipeline.prior.load import load_prior
from pipeline.render.draw_metrics import coverage
from pipeline.render.envmap import resample_area, sh_coefficients
from pipeline.render.metrics import held_out_photos, light_psnr, psnr, render_twice, view_rays
from pipeline.render.observe import Tracer
from pipeline.render.renderer import Explanation
from pipeline.run.stage import overrides
from pipeline.run.workflow import checked_name

RELIT = 200  # pixels per held-out view that are relit
RELIT_SPP = 512  # paths for each
AT_ONCE = 64  # of those paths in one pass
HELD_OUT_SPP = 64
METAL = 0.5  # metallic from which a surface counts as metal


def aligned_rms(a: np.ndarray, b: np.ndarray) -> tuple[float, float]:
    """RMS of a - b (n, 3): raw, and after a least-squares factor per channel."""
    rms = lambda e: float(np.sqrt((e**2).mean()))
    return rms(a - b), rms(a * ((a * b).sum(0) / np.maximum((a * a).sum(0), 1e-12)) - b)


class Truth:
    """What is known of a rendered scene, at fixed pixels of its held-out views: base colour,
    another light's picture, the light. Radiance is in the unit of the scene's work folder, in which
    `white` of the truth's is 1.
    """

    def __init__(self, folder: Path, problem, mesh: Path, light_rows: int, white: float):
        own = read_exr(folder / "envmap.exr") / white
        self.light = resample_area(own, light_rows, 2 * light_rows)
        views = problem.observations.held_out
        self.uv, shown = self._shown(folder, views, Tracer(mesh))
        self.colours = shown["albedo"]
        self.roughness = shown["roughness"]
        self.metallic = shown["metallic"]
        other = next(
            f for f in sorted((folder / "relight").glob("*.exr")) if f.with_suffix("").is_dir()
        )
        self.other_light = read_exr(other) / white
        self.pixels = []
        self.relit = []
        for view in views:
            picture = read_exr(other.with_suffix("") / f"{view.name}.exr") / white
            inside = cv2.erode((picture.sum(-1) > 0).astype(np.uint8), np.ones((5, 5)))
            rows, columns = np.random.default_rng(0).permutation(np.argwhere(inside))[:RELIT].T
            self.pixels.append((view, np.stack([columns, rows], -1)))
            self.relit.append(picture[rows, columns])
        self.relit = np.concatenate(self.relit)
        self.region = group(self.colours)[0]

    @staticmethod
    def _shown(folder: Path, views, tracer: Tracer) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """Texture coordinates (n, 2) and true values at every second pixel: "albedo" (n, 3),
        "roughness" and "metallic" (n,).
        """
        where = []
        values: dict[str, list[np.ndarray]] = {"albedo": [], "roughness": [], "metallic": []}
        for view in views:
            rows, columns = np.mgrid[0 : view.height : 2, 0 : view.width : 2].reshape(2, -1)
            uv, _, hit = tracer.hit(*view.rays(np.stack([columns + 0.5, rows + 0.5], -1)))

            pictures = {name: read_exr(folder / name / f"{view.name}.exr") for name in values}
            albedo = pictures["albedo"]
            row = (rows * len(albedo) / view.height).astype(int)
            column = (columns * albedo.shape[1] / view.width).astype(int)
            hit &= albedo[row, column].max(-1) > 0

            where.append(uv[hit])
            for name, picture in pictures.items():
                values[name].append(picture[row, column][hit])
        uv = np.concatenate(where)
        shown = {name: np.concatenate(parts) for name, parts in values.items()}
        one = lambda grey: grey.reshape(len(uv), -1)[:, 0]  # a grey EXR may have three channels
        return uv, shown | {name: one(shown[name]) for name in ("roughness", "metallic")}

    def relit_by(self, x: Explanation, renderer) -> np.ndarray:
        """Radiance of the same pixels under the other light, of `x`; twice, with independent noise
        (2, n, 3).
        """
        light = resample_area(self.other_light, *renderer.light_shape[:2]).astype(np.float32)
        renderer.set(replace(x, light=light))

        passes = RELIT_SPP // 2 // AT_ONCE
        many = lambda view, at: view_rays(view, np.repeat(at, AT_ONCE, 0))
        paths = lambda seed: np.concatenate(
            [renderer.mean_radiance(many(view, at), passes, seed) for view, at in self.pixels]
        )
        return np.stack([paths(seed).reshape(-1, AT_ONCE, 3).mean(1) for seed in (0, 1)])

    def unknowns(self, light: np.ndarray, colours: np.ndarray, relit_pixels: np.ndarray) -> dict:
        """What intervals are drawn about: SH coefficients of the light (order 2) raw and over its
        mean, mean base colour of the regions of like true colour raw and over the mean of all,
        relit pixels.
        """
        sh = sh_coefficients(light).reshape(-1, 3)
        means = np.stack([colours[self.region == r].mean(0) for r in range(self.region.max() + 1)])
        return {
            "sh": sh.ravel(),
            "sh_relative": (sh[1:] / sh[0].mean()).ravel(),
            "base_colour": means.ravel(),
            "base_colour_relative": (means / colours.mean()).ravel(),
            "relit": relit_pixels.ravel(),
        }

    def gloss_errors(self, x: Explanation) -> dict[str, float]:
        """Of roughness and metallic, where the held-out views show the object."""
        roughness, metallic = (
            gather(np.ascontiguousarray(values), self.uv)[:, 0]
            for values in (x.roughness, x.metallic)
        )
        ratio = np.log(roughness / np.maximum(self.roughness, 1e-3))
        right = (metallic > METAL) == (self.metallic > METAL)
        return {
            "log_roughness_error": float(np.median(np.abs(ratio))),
            "log_roughness_bias": float(np.median(ratio)),
            "metallic_right": float(right.mean()),
            "metallic_error": float(np.abs(metallic - self.metallic).mean()),
        }

    def scores(self, x: Explanation, renderer) -> tuple[dict, dict]:
        """Errors of `x`, and its own values of the unknowns."""
        colours = gather(x.base_color, self.uv)
        pixels, again = self.relit_by(x, renderer)
        raw, aligned = aligned_rms(colours, self.colours)
        return {
            "light_psnr": light_psnr(x.light, self.light),
            "base_colour_rms": raw,
            "base_colour_rms_aligned": aligned,
            "relit_psnr": psnr(pixels, self.relit, again=again),
            **self.gloss_errors(x),
        }, self.unknowns(x.light, colours, 0.5 * (pixels + again))


def judge(method: str, scene, folders: dict, folder: Path, samples: int) -> dict:
    """One method on one scene."""
    prior = load_prior(scene.sample.prior)
    load = lambda texture: load_problem(
        folders["observe"],
        folders["poses"],
        folders["atlas"],
        folders["mesh"],
        scene,
        texture,
        prior.height,
    )
    settings = scene.refine.model_copy(update={"steps": 0})
    full = load(settings.texture)
    held = held_out_photos(full, folders["poses"], folders["mesh"], scene.observe.erode)
    mean_psnr = lambda pictures: float(
        np.mean([psnr(a, photo, mask, b) for (a, b), (_, photo, mask) in zip(pictures, held)])
    )
    truth = None  # it has the frame of the given cameras
    if (folder / "transforms.json").exists() and (folder / "truth").is_dir():
        white = Radiance.load(folders["capture"]).white
        mesh = folders["atlas"] / "mesh_uv.ply"
        truth = Truth(folder / "truth", full, mesh, prior.height, white)

    rows = []
    pictures = []
    drawn_lights = []
    quantities = []
    for seed in range(samples):
        problem = load(scene.sample.texture)
        set_threads(1)
        began = time.perf_counter()
        drawn, facts = SAMPLERS[method](
            problem, prior, Explanation.load(folders["fit"]), scene.sample, seed
        )
        row = {"seconds": time.perf_counter() - began}
        set_threads(2)
        with Bar(f"refine {seed}", units(settings)) as bar:
            scale_drawn = SAMPLERS[method].scale_drawn
            final, _ = refine(full, drawn, settings, seed, bar, scale_drawn)
        pictures.append(
            [render_twice(full.renderer, final, view, mask, HELD_OUT_SPP) for view, _, mask in held]
        )
        row["held_out_psnr"] = mean_psnr(pictures[-1])
        if truth:
            scores, values = truth.scores(final, full.renderer)
            row |= scores
            quantities.append(values)
            drawn_lights.append(np.log(np.maximum(final.light, 1e-6)))
        rows.append(row)

    out = {"method": method, "samples": samples} | {
        k: round(float(np.mean([r[k] for r in rows])), 4) for k in rows[0]
    }
    out["peak_gib"] = round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20, 2)
    out["held_out_psnr_of_mean"] = mean_psnr(
        [np.mean(of_view, axis=0) for of_view in zip(*pictures)]
    )
    if truth:
        out["light_psnr_of_mean"] = light_psnr(np.exp(np.mean(drawn_lights, 0)), truth.light)
    if truth and samples > 2:
        true = truth.unknowns(truth.light, truth.colours, truth.relit)
        out["coverage"] = {k: coverage(np.array([q[k] for q in quantities]), true[k]) for k in true}
    return out


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--scene", nargs=2, action="append", metavar=("NAME", "FOLDER"), required=True
    )
    parser.add_argument(
        "--methods",
        nargs="+",
        default=["split_gibbs", "gaussian", "dpi_paper", "dpi_code", "sds", "map"],
    )
    parser.add_argument("--samples", type=int, default=2)
    parser.add_argument("--work", type=Path, default=Path("work"))
    parser.add_argument("--set", nargs="*", default=[], help="settings as section.key=value")
    parser.add_argument("--out", type=Path)
    args = parser.parse_args()
    rows = []
    for name, folder in args.scene:
        scene = parse_scene({"photos": folder} | overrides(args.set), name)
        folders = {
            s: args.work / checked_name(name) / s
            for s in ("capture", "poses", "mesh", "atlas", "observe", "fit")
        }
        for method in args.methods:
            rows.append({"scene": name} | judge(method, scene, folders, Path(folder), args.samples))
            print(json.dumps(rows[-1]), flush=True)
    if args.out:
        write_json(
            args.out, {"machine": f"{platform.machine()}, {os.cpu_count()} cores", "rows": rows}
        )


if __name__ == "__main__":
    run_stage(main)
