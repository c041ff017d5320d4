"""Scenes of known light and materials for `benchmarks.samplers`: renders them and runs their stages
up to the fit.

python -m benchmarks.pairs --maker make_scene.py --assets GT_ASSETS --lights ENVMAPS --out FOLDER [--preset draft]

Each pair of PAIRS becomes FOLDER/<asset>__<light>; its lights are not among those the shipped
priors were trained on. Prints the --scene options for benchmarks.samplers. What exists already is
not made again.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from pathlib import Path

from benchmarks.scenes import snakemake
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


def render(maker: Path, assets: Path, lights: Path, asset: str, light: str, out: Path) -> None:
    """A scene folder of 16 photos and 4 held-out views, 320 pixels, 48 paths each."""
    from pipeline.base import runtime  # noqa: F401  (finds LLVM and says so in the environment)

    command = [
        sys.executable,
        maker,
        assets / asset,
        lights / f"{light}.exr",
        out,
        "--size",
        "320",
        "--spp",
        "48",
        "--views",
        "16",
        "--test",
        "4",
        "--relight",
        lights / f"{RELIGHT}.exr",
    ]
    subprocess.run([str(c) for c in command], check=True, env=os.environ)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--maker", type=Path, required=True, help="the project's scene maker")
    parser.add_argument("--assets", type=Path, required=True)
    parser.add_argument("--lights", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--preset", default="draft")
    args = parser.parse_args()
    for asset, light in PAIRS.items():
        folder = (args.out / f"{asset}__{light}").resolve()
        if not (folder / "truth" / "relight" / f"{RELIGHT}.exr").exists():
            render(args.maker, args.assets, args.lights, asset, light, folder)
        snakemake(
            folder,
            [f"work/{folder.name}/fit/fit.json", f"work/{folder.name}/mesh/mesh.json"],
            [f"preset={args.preset}"],
        )
        print(f"--scene {folder.name} {folder}", flush=True)


if __name__ == "__main__":
    run_stage(main)
