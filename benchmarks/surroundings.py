"""What the photos show around the object as evidence, each part on and off.

python -m benchmarks.surroundings --finished work --photos FOLDER --sets garden,brass_head \\
    --samples 2 --set preset=draft --out rows.json

--finished holds scenes whose stages up to `atlas` are done; they are only read. Every set is
observed, fitted, drawn, refined (base colour only) and scored anew with neither part, with the
ground, with the background, with both, and with the tint alone, in work/surroundings. Rows:
held-out dB of the draws (on the ground where it is evidence) and of the asset under its light
alone, as it is exported; and what was found. `garden`, whose scene is known, has further:

  light dB against the light that meets the object's place: sky, hedge and table seen from the
    object's centre, without the object; and the same in the sky alone, SKY degrees and more above
    the horizon;
  relit dB: the asset in the true scene (table, lawn, hedge) in the object's place, under the
    evening light of truth/relight, against its pictures there;
  the draws' mean radiance over the true one.
"""

from __future__ import annotations

import argparse
import json
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from benchmarks.geometry import Similarity, true_positions, umeyama
from benchmarks.real_sets import GARDEN, scene_folder
from benchmarks.scenes import ROOT, machine
from examples import make_garden
from pipeline.base.config import Scene, parse_scene
from pipeline.base.errors import run_stage
from pipeline.base.files import read_json, write_json
from pipeline.base.images import read_exr
from pipeline.base.progress import Bar
from pipeline.base.runtime import mitsuba as mi
from pipeline.base.runtime import mitsuba_rays, set_threads
from pipeline.geometry.cameras import OPENCV_FROM_OPENGL, View, load_cameras
from pipeline.geometry.surface import Surface
from pipeline.posterior.fit import fit
from pipeline.posterior.load import load_problem
from pipeline.posterior.problem import Problem
from pipeline.posterior.refine import refine, units
from pipeline.posterior.samplers import SAMPLERS
from pipeline.prior.load import load_prior
from pipeline.render.envmap import direction_from_uv, mean_radiance
from pipeline.render.metrics import held_out_photos, light_psnr, psnr, score_held_out, view_rays
from pipeline.render.observe import make_observations
from pipeline.render.renderer import Explanation, Renderer
from pipeline.render.shading_normals import with_normal_map
from pipeline.run.stage import overrides


class Parts(NamedTuple):
    """Which parts of the surroundings are evidence."""

    ground: bool = False
    background: bool = False
    tint: bool = False

    def settings(self) -> dict[str, bool]:
        """As settings of the section `observe`."""
        return self._asdict()


VARIANTS = {
    "neither": Parts(),
    "ground": Parts(ground=True),
    "background": Parts(background=True),
    "both": Parts(ground=True, background=True),
    "tint": Parts(tint=True),
}
SKY = 20.0  # degrees above the horizon: the hedge ends below
RELIT, PATHS = 300, 256  # pixels of each view that are relit, and paths through each
LIGHT_PATHS = 256  # per pixel of the true light


class Garden:
    """The true scene of the shipped example, in its own frame."""

    def __init__(self, cameras: Path):
        rig = load_cameras(cameras)
        self.truth = ROOT / "examples" / GARDEN / "truth"
        found = np.stack([view.position for view in rig.views])
        true = true_positions(rig.views, self.truth / "transforms_truth.json")
        self.to_truth: Similarity = umeyama(found, true)
        self.centre = self.to_truth.points(rig.center[None])[0]
        self.around = make_garden.build_parts(0)[3:]

    def scene(self, light: np.ndarray, *, asset: dict | None = None):
        """Table, lawn and hedge under a light, and an asset among them."""
        parts = {part.name: make_garden.to_mesh(part) for part in self.around}
        sky = {"type": "envmap", "bitmap": mi.Bitmap(light)}
        scene = {"type": "scene", "light": sky} | parts
        return mi.load_dict(scene if asset is None else scene | {"asset": asset})

    def radiance(self, scene, origins: np.ndarray, directions: np.ndarray, seed: int) -> np.ndarray:
        """One path per ray, as long as the photos': (n, 3)."""
        import drjit as dr  # after pipeline, which has pointed it at its LLVM

        integrator = mi.load_dict({"type": "prb", "max_depth": 4, "rr_depth": 1000})
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(seed, len(origins))
        found = integrator.sample(
            mode=dr.ADMode.Primal,
            scene=scene,
            sampler=sampler,
            ray=mitsuba_rays(origins, directions),
            δL=None,
            state_in=None,
            active=mi.Bool(True),
        )
        return np.array(found[0]).T.reshape(-1, 3)

    def light(self, rows: int) -> np.ndarray:
        """What meets the object's centre without the object, (rows, 2 rows, 3), in the frame of the
        reconstruction.
        """
        scene = self.scene(read_exr(self.truth / "envmap.exr"))
        rng = np.random.default_rng(0)
        total = np.zeros((2 * rows * rows, 3))
        row, column = np.mgrid[0:rows, 0 : 2 * rows].reshape(2, -1)
        for seed in range(LIGHT_PATHS):
            jitter = rng.random((2, len(row)))
            ours = direction_from_uv((column + jitter[0]) / (2 * rows), (row + jitter[1]) / rows)
            directions = self.to_truth.directions(ours)
            origins = np.broadcast_to(self.centre, directions.shape)
            total += self.radiance(scene, origins, directions, seed)
        return (total / LIGHT_PATHS).reshape(rows, 2 * rows, 3).astype(np.float32)

    @cached_property
    def relit(self) -> list[tuple[View, np.ndarray, np.ndarray]]:
        """Views with truth under the evening light: pixels (RELIT, 2) of the object, columns and
        rows, and their radiance (RELIT, 3).
        """
        cameras = json.loads((self.truth / "transforms_truth.json").read_text())
        frames = {Path(f["file_path"]).stem: f for f in cameras["frames"]}
        found = []
        for file in sorted((self.truth / "relight" / "evening").glob("*.exr")):
            picture = read_exr(file)
            height, width = picture.shape[:2]
            lens = cameras["fl_x"] * width / cameras["w"]
            pose = np.array(frames[file.stem]["transform_matrix"]) @ OPENCV_FROM_OPENGL
            middle = width / 2, height / 2
            view = View(file.stem, "", width, height, lens, lens, *middle, np.linalg.inv(pose))
            inside = cv2.erode((picture.sum(-1) > 0).astype(np.uint8), np.ones((7, 7)))
            rows, columns = np.random.default_rng(0).permutation(np.argwhere(inside))[:RELIT].T
            found.append((view, np.stack([columns, rows], -1), picture[rows, columns]))
        return found

    def relit_psnr(self, x: Explanation, mesh: Path) -> float:
        """Of an explanation's materials on its mesh, put into the true scene by evening."""
        scene = self.scene(
            read_exr(self.truth / "relight" / "evening.exr"), asset=self._asset(x, mesh)
        )
        halves = []
        for seed in (0, 1):
            rng = np.random.default_rng(seed)
            pictures = []
            for view, pixels, _ in self.relit:
                rays = view_rays(view, np.repeat(pixels, PATHS // 2, 0))(rng)
                paths = self.radiance(scene, *rays, seed)
                pictures.append(paths.reshape(len(pixels), -1, 3).mean(1))
            halves.append(np.concatenate(pictures))
        return psnr(halves[0], np.concatenate([truth for *_, truth in self.relit]), again=halves[1])

    def _asset(self, x: Explanation, mesh: Path) -> dict:
        """Mitsuba's description of an explanation on its mesh, in the true frame."""
        to_world = np.eye(4)
        to_world[:3, :3] = self.to_truth.scale * self.to_truth.rotation
        to_world[:3, 3] = self.to_truth.shift

        def texture(values: np.ndarray) -> dict:
            data = mi.TensorXf(np.ascontiguousarray(np.atleast_3d(values), np.float32))
            return {"type": "bitmap", "raw": True, "wrap_mode": "clamp", "data": data}

        material = {
            "type": "principled",
            "specular": 0.5,
            "base_color": texture(x.base_color),
            "roughness": texture(x.roughness),
            "metallic": texture(x.metallic),
        }
        return {
            "type": "ply",
            "filename": str(mesh),
            "flip_tex_coords": True,
            "to_world": mi.ScalarTransform4f(to_world),
            "bsdf": {"type": "twosided", "b": with_normal_map(material, Surface.of(mesh))},
        }

    def scores(self, x: Explanation, mesh: Path, truth: np.ndarray) -> dict[str, float]:
        """Figures of an explanation, `truth` the light at its size."""
        sky = round((0.5 - SKY / 180) * len(truth))
        return {
            "light_psnr": light_psnr(x.light, truth),
            "sky_psnr": light_psnr(x.light, truth, rows=sky),
            "relit_psnr": self.relit_psnr(x, mesh),
            "radiance_over_truth": float(
                mean_radiance(x.light).mean() / mean_radiance(truth).mean()
            ),
        }


class Variant:
    """One set with some of its surroundings as evidence. finished: its stages up to `atlas`; work:
    where its draws go, and are kept: delete the folder to draw anew.
    """

    def __init__(self, finished: Path, work: Path, scene: Scene):
        self.finished = finished
        self.work = work
        self.scene = scene
        self.mesh = finished / "atlas" / "mesh_uv.ply"
        self.prior = load_prior(scene.sample.prior)
        work.mkdir(parents=True, exist_ok=True)
        if not (work / "observe.json").exists():
            stages = finished / "poses", finished / "mesh", self.mesh, work
            write_json(work / "observe.json", make_observations(*stages, scene.observe))

    def problem(self, texture: int, light_height: int) -> Problem:
        """As the stages load it."""
        poses, atlas, mesh = (self.finished / stage for stage in ("poses", "atlas", "mesh"))
        return load_problem(self.work, poses, atlas, mesh, self.scene, texture, light_height)

    @cached_property
    def start(self) -> Explanation:
        """The fit, made when the first draw asks for it."""
        scene = self.scene
        return fit(self.problem(scene.fit.texture, scene.render.light_height), scene.fit)[0]

    @cached_property
    def full(self) -> Problem:
        """At the size of the exported textures."""
        return self.problem(self.scene.refine.texture, self.prior.height)

    def draw(self, seed: int) -> Explanation:
        """A refined draw, as it was kept or made now."""
        folder = self.work / str(seed)
        if not (folder / "light.exr").exists():
            scene = self.scene
            settings = scene.refine.model_copy(update={"steps": 0})
            problem = self.problem(scene.sample.texture, self.prior.height)
            sampler = SAMPLERS[scene.sample.method]
            drawn, _ = sampler(problem, self.prior, self.start, scene.sample, seed)
            with Bar(f"refine {seed}", units(settings)) as bar:
                held = sampler.scale_drawn
                final, _ = refine(self.full, drawn, settings, seed, bar, held)
            final.save(folder)
        return Explanation.load(folder)

    def held_out(self, x: Explanation) -> dict[str, float]:
        """Held-out dB on the ground, if it is known, and of the asset and its light alone."""
        settings, poses = self.scene.refine, self.finished / "poses"
        held = held_out_photos(self.full, poses, self.finished / "mesh", self.scene.observe.erode)
        score = lambda problem: score_held_out(
            problem, x, held, settings.score_pixels, settings.score_spp
        )
        found = {"held_out_psnr": score(self.full)["held_out_psnr"]}
        if self.full.renderer.ground is None:
            return found | {"alone_psnr": found["held_out_psnr"]}

        depth = self.scene.render.max_depth
        renderer = Renderer(self.mesh, len(x.metallic), len(x.light), depth)
        alone = Problem(self.full.observations, renderer, self.full.roughness_min)
        return found | {"alone_psnr": score(alone)["held_out_psnr"]}

    def row(self, samples: int, garden: Garden | None) -> dict:
        """Means over the draws, the draws, and what was found around the object."""
        truth = garden.light(self.prior.height) if garden else None
        rows = []
        for seed in range(samples):
            x = self.draw(seed)
            row = self.held_out(x) | {"metallic_share": float((x.metallic > 0.5).mean())}
            if garden and truth is not None:
                row |= garden.scores(x, self.mesh, truth)
            rows.append(row)
        mean = {key: float(np.mean([row[key] for row in rows])) for key in rows[0]}
        found = read_json(self.work / "observe.json")
        parts = ("ground", "background", "surr", "tint")
        kept = {k: v for k, v in found.items() if k.startswith(parts)}
        return mean | kept | {"samples": rows}


def add_options(parser: argparse.ArgumentParser) -> None:
    """What is there, and what is drawn from it."""
    parser.add_argument("--finished", type=Path, required=True, help="a work/ with done scenes")
    parser.add_argument("--photos", type=Path, required=True, help="folder of their photos")
    parser.add_argument("--samples", type=int, default=2)
    parser.add_argument("--set", nargs="*", default=[], help="settings as section.key=value")
    parser.add_argument("--out", type=Path, required=True)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add_options(parser)
    parser.add_argument("--sets", required=True, help="names with commas between")
    parser.add_argument("--variants", default=",".join(VARIANTS))
    args = parser.parse_args()

    set_threads(1)  # as in the sample stage
    rows = []
    for name in args.sets.split(","):
        finished = args.finished / name
        garden = Garden(finished / "poses" / "cameras.json") if name == GARDEN else None
        for variant in args.variants.split(","):
            scene = parse_scene(
                {"photos": str(scene_folder(args.photos, name))} | overrides(args.set), name
            )
            observe = scene.observe.model_copy(update=VARIANTS[variant].settings())
            scene = scene.model_copy(update={"observe": observe})
            work = ROOT / "work" / "surroundings" / name / variant
            row = Variant(finished, work, scene).row(args.samples, garden)
            rows.append({"scene": name, "variant": variant} | row)
            print(json.dumps(rows[-1]), flush=True)
            write_json(args.out, {"machine": machine(), "rows": rows})


if __name__ == "__main__":
    run_stage(main)
