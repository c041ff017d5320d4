"""Scenes of known light and materials for `benchmarks.samplers`: renders them and runs their stages
up to the fit.

python -m benchmarks.pairs --assets ASSETS --lights ENVMAPS --out FOLDER [--preset draft]

ASSETS/<asset> and ENVMAPS/<light>.exr are what benchmarks.make_scene renders from.
Each pair of PAIRS becomes FOLDER/<asset>__<light>; its lights are not among those the shipped
priors were trained on. Prints the --scene options for benchmarks.samplers. What exists already is
not made again.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from benchmarks.make_scene import Options, make_scene
from benchmarks.scenes import AS_CONFIGURED, snakemake
from pipeline.base.errors import run_stage

PAIRS = {
    "boombox": "vestibule",
    "bob_bronze": "indoor_market",
    "avocado": "kernerenv",
    "toy_car": "river_road_2",
    "suzanne": "pisa",
    "corset": "natural_studio",
    "lantern": "grace_new_128",
    "antique_camera": "kitchen_pierre",
}
RELIGHT = "barce_rooftop_c"
OPTIONS = Options(size=320, spp=48, views=16, test=4)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--assets", type=Path, required=True)
    parser.add_argument("--lights", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--preset", default="draft")
    args = parser.parse_args()

    other = args.lights / f"{RELIGHT}.exr"
    for asset, light in PAIRS.items():
        folder = (args.out / f"{asset}__{light}").resolve()
        if not (folder / "truth" / "relight" / f"{RELIGHT}.exr").exists():
            source = args.lights / f"{light}.exr"
            make_scene(args.assets / asset, source, [other], OPTIONS, folder)
        targets = [f"work/{folder.name}/fit/fit.json", f"work/{folder.name}/mesh/mesh.json"]
        snakemake(folder, targets, [f"preset={args.preset}", AS_CONFIGURED])
        print(f"--scene {folder.name} {folder}", flush=True)


if __name__ == "__main__":
    run_stage(main)
