"""What the mean of a scene's samples is worth, beside the samples.

python -m benchmarks.mean_of_samples --finished WORK --sets garden,banana --out rows.json

WORK holds runs of the chain on photos without truth: what is scored are photos that were held out,
as the refine stage scores them. Of scenes with truth the study has rows (study.methods, `_mean`).

A row: `scene`, `samples`, the scores of each, and `mean`, those of `samples.mean_of`.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from benchmarks.scenes import machine
from pipeline.base.config import parse_scene
from pipeline.base.errors import InputError, run_stage
from pipeline.base.files import read_json, write_json
from pipeline.base.progress import progress
from pipeline.base.runtime import set_threads
from pipeline.posterior.choose.chosen import chosen_scene
from pipeline.render.metrics import held_out_photos, score_held_out
from pipeline.render.observe import Observations
from pipeline.render.renderer import Explanation, Renderer
from pipeline.render.samples import FEWEST, Samples, mean_of
from pipeline.report.make import HeldOut


def samples_in(folder: Path) -> Samples:
    """Refined samples 0, 1, ... of a folder. Raises InputError for fewer than two."""
    count = len([path for path in folder.glob("*") if path.name.isdigit()])
    if count < FEWEST:
        raise InputError("there are fewer than two samples", folder, "draw more, samples: 2")
    return Samples([folder / str(k) for k in range(count)])


def with_mean(samples: Samples) -> list[Explanation]:
    """The samples, and last their mean."""
    mean = mean_of(samples, samples.weights)
    assert mean is not None  # there are two at least
    return [*samples, mean]


def on_held_out(work: Path, preset: str) -> dict:
    """The row of a finished run on photos."""
    scene = chosen_scene(
        parse_scene({"photos": work.name, "preset": preset}, work), work / "choose"
    )
    samples = samples_in(work / "refine")
    first, poses, settings = samples[0], work / "poses", scene.refine
    observations = Observations(work / "observe", poses / "cameras.json")
    sizes = len(first.base_color), len(first.light), scene.render.max_depth
    mesh, ground = work / "atlas" / "mesh_uv.ply", observations.surroundings.ground
    judge = HeldOut(observations, Renderer(mesh, *sizes, ground))
    photos = held_out_photos(judge, poses, work / "mesh", scene.observe.erode)
    score = lambda x: score_held_out(judge, x, photos, settings.score_pixels, settings.score_spp)
    scored = [{"held_out_psnr": score(x)["held_out_psnr"]} for x in with_mean(samples)]
    return {"scene": work.name, "preset": preset, "samples": scored[:-1], "mean": scored[-1]}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--finished", type=Path, metavar="WORK", required=True)
    parser.add_argument("--sets", required=True, help="names in WORK, with commas between")
    parser.add_argument("--preset", default="standard")
    parser.add_argument("--out", type=Path, required=True, help="JSON file for all rows")
    args = parser.parse_args()

    set_threads(1)
    rows = read_json(args.out)["rows"] if args.out.exists() else []
    done = {row["scene"] for row in rows}
    left = [name for name in args.sets.split(",") if name not in done]
    for name in progress(left, "means of samples"):
        rows.append(on_held_out(args.finished / name, args.preset))
        write_json(args.out, {"machine": machine(), "rows": rows})


if __name__ == "__main__":
    run_stage(main)
