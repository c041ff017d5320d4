"""Is gloss found? Textured meshes in constant materials, rendered and drawn, scored by roughness
and metallic.

python -m benchmarks.gloss --assets ASSETS --lights ENVMAPS --out FOLDER [--quick] [--samples 2] \\
    [--rows rows.json]

ASSETS/<asset> and ENVMAPS/<light>.exr are what benchmarks.make_scene renders from. Every asset of
SHAPES keeps its mesh and, but for cloth and brushed metal, its base colour, and gets one material
of MATERIALS all over; each is photographed under both LIGHTS, which the shipped priors were not
trained on. `--quick` takes the first light only, and the three glosses. Scenes are made as
FOLDER/<asset>_<material>__<light>, their stages up to the fit in work/; what exists already is not
made again.

Every draw is scored as in benchmarks.samplers: `log_roughness_error` is the median over held-out
views of |log(drawn / true)|, `metallic_right` the share of the surface on its right side of one
half.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from benchmarks.make_scene import Options, check_asset, make_scene
from benchmarks.samplers import judge
from benchmarks.scenes import AS_CONFIGURED, snakemake
from pipeline.base.config import parse_scene
from pipeline.base.errors import run_stage
from pipeline.base.files import write_json
from pipeline.run.stage import overrides

SHAPES = ("avocado", "boombox", "suzanne")
LIGHTS = ("vestibule", "kernerenv")
RELIGHT = "barce_rooftop_c"
OPTIONS = Options(size=200, spp=32, views=24, test=3)
TEXTURE = 64  # pixels along a side of a constant map
STAGES = ("capture", "poses", "mesh", "atlas", "observe", "fit")


@dataclass(frozen=True)
class Material:
    """One material all over; color: sRGB grey in [0, 255], or the asset's own base colour."""

    roughness: float
    metallic: float
    color: int | None = None


MATERIALS = {
    "gloss10": Material(0.1, 0.0),
    "gloss20": Material(0.2, 0.0),
    "gloss40": Material(0.4, 0.0),
    "cloth": Material(0.9, 0.0, color=40),
    "brushed": Material(0.3, 1.0, color=200),
}
QUICK = ("gloss10", "gloss20", "gloss40")


def constant(path: Path, value: float) -> None:
    """Write a grey 8-bit picture of `value` in [0, 1]."""
    pixels = np.full((TEXTURE, TEXTURE), round(255 * value), np.uint8)
    Image.fromarray(pixels).save(path)


def make_asset(source: Path, material: Material, out: Path) -> None:
    """The asset `source` in another material, as a folder that make_scene takes. Raises InputError
    when the asset lacks a file.
    """
    check_asset(source)
    out.mkdir(parents=True, exist_ok=True)
    shutil.copy(source / "mesh.ply", out / "mesh.ply")
    constant(out / "roughness.png", material.roughness)
    constant(out / "metallic.png", material.metallic)
    if material.color is None:
        shutil.copy(source / "base_color.png", out / "base_color.png")
    else:
        grey = np.full((TEXTURE, TEXTURE, 3), material.color, np.uint8)
        Image.fromarray(grey).save(out / "base_color.png")


def prepare(shape: str, name: str, light: str, args: argparse.Namespace) -> Path:
    """The scene's folder, rendered, with its stages up to the fit done."""
    folder = (args.out / f"{shape}_{name}__{light}").resolve()
    if not (folder / "truth" / "relight" / f"{RELIGHT}.exr").exists():
        asset = args.out / "assets" / f"{shape}_{name}"
        make_asset(args.assets / shape, MATERIALS[name], asset)
        other = args.lights / f"{RELIGHT}.exr"
        make_scene(asset, args.lights / f"{light}.exr", [other], OPTIONS, folder)

    targets = [f"work/{folder.name}/{s}/{s}.json" for s in ("fit", "mesh")]
    snakemake(folder, targets, [f"preset={args.preset}", AS_CONFIGURED])
    return folder


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--assets", type=Path, required=True)
    parser.add_argument("--lights", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--quick", action="store_true", help="one light, the three glosses")
    parser.add_argument("--shapes", nargs="+", default=SHAPES, choices=SHAPES)
    parser.add_argument("--materials", nargs="+", default=None, choices=list(MATERIALS))
    parser.add_argument("--method", default="split_gibbs")
    parser.add_argument("--samples", type=int, default=1, help="draws of each; 0: render only")
    parser.add_argument("--preset", default="draft")
    parser.add_argument("--work", type=Path, default=Path("work"))
    parser.add_argument("--set", nargs="*", default=[], help="settings as section.key=value")
    parser.add_argument("--rows", type=Path, help="JSON file for all rows")
    args = parser.parse_args()

    materials = args.materials or (QUICK if args.quick else list(MATERIALS))
    lights = LIGHTS[:1] if args.quick else LIGHTS
    settings = [f"preset={args.preset}", *args.set]
    rows = []
    for light in lights:
        for shape in args.shapes:
            for name in materials:
                folder = prepare(shape, name, light, args)
                if not args.samples:
                    continue
                scene = parse_scene({"photos": folder} | overrides(settings), folder.name)
                folders = {stage: args.work / folder.name / stage for stage in STAGES}
                row = judge(args.method, scene, folders, folder, args.samples)
                rows.append({"scene": folder.name, "material": name} | row)
                print(json.dumps(rows[-1]), flush=True)

    if args.rows:
        machine = f"{platform.machine()}, {os.cpu_count()} cores"
        write_json(args.rows, {"machine": machine, "preset": args.preset, "rows": rows})


if __name__ == "__main__":
    run_stage(main)
