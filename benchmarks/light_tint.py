"""The tint of draws' lights beside the true one's, with what photos show around and without.

python -m benchmarks.light_tint --finished WORK --photos FOLDER --lights ENVMAPS \\
    --things vase,bowl --set preset=draft --out rows.json

WORK holds runs of benchmarks.tabletop up to `atlas`, FOLDER its photos; both are only read. Every
thing is observed, fitted, drawn, refined (base colour only) and scored anew with `observe.tint` on
and off, in work/surroundings. Tints are of the mean radiance over the sphere, warm against cold and
green against magenta (pipeline/render/tint.py): the true map's, what is found around the object,
the middle of what is drawn from that, and of every draw.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

from benchmarks.scenes import ROOT, machine
from benchmarks.surroundings import VARIANTS, Variant, add_options
from benchmarks.tabletop import THINGS
from pipeline.base.config import parse_scene
from pipeline.base.errors import run_stage
from pipeline.base.files import read_json, write_json
from pipeline.base.images import read_exr
from pipeline.base.runtime import set_threads
from pipeline.posterior.split_gibbs.light_tint import drawn_tint
from pipeline.render.envmap import mean_radiance
from pipeline.render.surroundings import Around
from pipeline.render.tint import TINTS, tint_of
from pipeline.run.stage import overrides

COMPARED = "neither", "tint"
MANY = 4000  # draws of a tint


def tint(light: np.ndarray) -> list[float]:
    """(2,) of a lat-long map's mean radiance."""
    return tint_of(mean_radiance(light)).tolist()


def middle(shown: list[float] | str | None) -> list[float] | None:
    """(2,) of the tints that are drawn where the surroundings' tint (2,) is known: their mean."""
    if not isinstance(shown, list):
        return None
    rng = np.random.default_rng(0)
    around = Around(np.exp(np.array(shown) @ TINTS))
    return np.mean([drawn_tint(around, rng) for _ in range(MANY)], 0).tolist()


def row_of(variant: Variant, seeds: range) -> dict:
    """What is around, what is drawn from it, and of every draw the light's tint and held-out dB."""
    draws = [variant.draw(seed) for seed in seeds]
    found = read_json(variant.work / "observe.json")
    return {
        "around": found.get("tint_around"),
        "middle": middle(found.get("tint_around")),
        "tints": [tint(x.light) for x in draws],
        "held_out_psnr": [variant.held_out(x)["held_out_psnr"] for x in draws],
    }


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add_options(parser)
    parser.add_argument("--lights", type=Path, required=True)
    parser.add_argument("--things", default=",".join(THINGS), help="names with commas between")
    args = parser.parse_args()

    set_threads(1)  # as in the sample stage
    rows = []
    for name in args.things.split(","):
        scene = f"{name}_table"
        row = {"scene": scene, "true": tint(read_exr(args.lights / f"{THINGS[name].light}.exr"))}
        for part in COMPARED:
            asked = VARIANTS[part].settings()
            settings = {"photos": str(args.photos / scene), "observe": asked}
            config = parse_scene(settings | overrides(args.set), scene)
            work = ROOT / "work" / "surroundings" / scene / part
            row[part] = row_of(Variant(args.finished / scene, work, config), range(args.samples))
        rows.append(row)
        print(json.dumps(row), flush=True)
        write_json(args.out, {"machine": machine(), "rows": rows})


if __name__ == "__main__":
    run_stage(main)
