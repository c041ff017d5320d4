"""Yardsticks of the study: what the photos show as a texture, which every method has to beat.

python -m benchmarks.study.yardsticks --suite XS --out FOLDER

    unlit         the texture as it is, under any light
    unlit_scaled  times a factor for each channel: the new light's mean radiance over the scene's
    diffuse       a matt asset of base colour texture / mean radiance of the scene's light, as if
                  that came evenly from everywhere, path traced under the new light

The texture is the photos' robust mean on the study's own mesh (`benchmarks.unlit`). Means of lights
are over solid angle, and true ones: a yardstick is told what a method has to find. FOLDER is that
of `benchmarks.study`; scenes, and stages up to the fit, are made here where they are not there. A
yardstick has a row a scene among those of the methods; a scene that has all of them is passed over.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from benchmarks.scenes import ROOT
from benchmarks.study import scenes
from benchmarks.study.__main__ import prepare
from benchmarks.study.methods import TEXTURE, YARDSTICKS
from benchmarks.study.rows import SPP
from benchmarks.study.store import ROWS, made_here, row_file, suite_folder
from benchmarks.unlit import bake, photo_pixels, picture
from pipeline.base.config import Observe
from pipeline.base.errors import run_stage
from pipeline.base.files import write_json
from pipeline.base.images import linear_to_srgb, srgb_to_linear
from pipeline.base.progress import progress
from pipeline.posterior.problem import ALBEDO_MAX
from pipeline.render.envmap import solid_angles
from pipeline.render.observe import Observations, Tracer
from pipeline.render.renderer import Explanation, Renderer
from pipeline.report.score import MAX_DEPTH, picture_scores, rendered, true_pictures
from pipeline.report.truth import Truth, truth_of_work


def mean_radiance(light: np.ndarray) -> np.ndarray:
    """Of a lat-long light (h, 2h, 3), over solid angle: (3,)."""
    weight = solid_angles(*light.shape[:2])[..., None]
    return (light * weight).sum((0, 1)) / weight.sum()


def unlit_pictures(
    texture: np.ndarray, tracer: Tracer, truth: Truth, scaled: bool
) -> dict[str, np.ndarray]:
    """The texture (t, t, 3), linear, in every true picture: (2, h, w, 3), the same twice."""
    own = mean_radiance(truth.known_light())
    shown = {}
    for name, (known, _, light) in true_pictures(truth).items():
        factor = mean_radiance(light) / own if scaled and light is not None else 1.0
        one = picture(known.view, known.mask, linear_to_srgb(texture), tracer) * factor
        shown[name] = np.stack([one, one])
    return shown


def matt(texture: np.ndarray, light: np.ndarray) -> Explanation:
    """The matt asset of a texture (t, t, 3) in photos under `light` (h, 2h, 3), with an even light
    of the same mean radiance.
    """
    mean = mean_radiance(light)
    color = np.clip(texture / mean, 0, ALBEDO_MAX).astype(np.float32)
    grey = lambda value: np.full(texture.shape[:2], value, np.float32)
    even = np.broadcast_to(mean, light.shape).astype(np.float32)
    return Explanation(even, color, grey(1), grey(0))


def textured(work: Path) -> np.ndarray:
    """The photos of a scene's folder as a texture (t, t, 3), linear."""
    poses = work / "poses"
    views = Observations(work / "observe", poses / "cameras.json").views
    tracer = Tracer(work / "atlas" / "mesh_uv.ply")
    pixels = photo_pixels(views, poses, work / "mesh", tracer, Observe().erode)
    return srgb_to_linear(bake(pixels, TEXTURE)[0]).astype(np.float32)


def scores_of_scene(work: Path, truth: Truth) -> dict[str, dict]:
    """The scores of all YARDSTICKS on one scene, and of each picture."""
    texture, light = textured(work), truth.known_light()
    mesh = work / "atlas" / "mesh_uv.ply"
    tracer = Tracer(mesh)
    renderer = Renderer(mesh, TEXTURE, len(light), MAX_DEPTH)
    pictures = {
        "unlit": unlit_pictures(texture, tracer, truth, False),
        "unlit_scaled": unlit_pictures(texture, tracer, truth, True),
        "diffuse": rendered(renderer, matt(texture, light), truth, SPP, lambda: None),
    }
    found = {name: picture_scores(shown, truth) for name, shown in pictures.items()}
    return {name: {"scores": scores, "views": views} for name, (scores, views) in found.items()}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    scenes.add_options(parser)
    parser.add_argument("--rows", type=Path, default=ROWS, help="the committed ones if not given")
    parser.add_argument("--note", default="", help="what rows say besides")
    parser.add_argument("--out", type=Path, required=True, help="folder for scenes")
    args = parser.parse_args()

    rows = suite_folder(args.rows, args.suite)
    command = f"python -m benchmarks.study.yardsticks {scenes.said(args)} --out FOLDER"
    about = {"suite": args.suite, "command": command, "note": args.note}
    about |= {"seed": 0, **made_here()}
    folders = scenes.scenes_of(args.suite, args.out / "scenes", args.given)
    for folder in progress(folders, "yardsticks"):
        files = {name: row_file(rows, folder.name, name, 0) for name in YARDSTICKS}
        if all(file.exists() for file in files.values()):
            continue
        prepare(folder)
        work = ROOT / "work" / folder.name
        found = scores_of_scene(work, truth_of_work(folder, work))
        for name, file in files.items():
            write_json(file, about | {"scene": folder.name, "method": name} | found[name])


if __name__ == "__main__":
    run_stage(main)
