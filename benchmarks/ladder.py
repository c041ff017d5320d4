r"""What the ladder of gloss and metal (pipeline/posterior/ladder.py) is worth: the same draws,
refined with `gloss: maps` and `gloss: tested`, beside the plain textured mesh.

python -m benchmarks.ladder --finished WORK --sets garden,banana --out rows.json
python -m benchmarks.ladder --finished WORK --sets w_vase__room_14 --truth SCENES \
    --preset draft --out rows.json

WORK/<set> holds the stages from poses to sample; SCENES/<set> the truth, where it is known
(docs/scene_folder.md). One row for each sample; what is in --out already is not made again.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import numpy as np

from benchmarks.scenes import machine
from benchmarks.unlit import score_unlit
from pipeline.base.config import Scene, parse_scene
from pipeline.base.errors import run_stage
from pipeline.base.files import read_json, write_json
from pipeline.base.progress import Bar
from pipeline.base.runtime import set_threads
from pipeline.posterior.draw_facts import DrawFacts
from pipeline.posterior.load import load_problem
from pipeline.posterior.refine import refine, units
from pipeline.posterior.textures import gather
from pipeline.render.metrics import held_out_photos, score_held_out
from pipeline.render.renderer import Explanation, Renderer
from pipeline.report.score import MAX_DEPTH, score_explanation
from pipeline.report.truth import Truth, truth_of_work

VARIANTS = ("maps", "tested")
SPP = 64  # paths per pixel of pictures that are scored against the truth


def variant(
    work: Path, scene: Scene, sample: Path, gloss: str, truth: Truth | None
) -> dict[str, object]:
    """Scores, seconds and rungs of one sample, refined with `gloss`."""
    drawn = Explanation.load(sample)
    settings = scene.refine.model_copy(update={"gloss": gloss})
    folders = [work / stage for stage in ("observe", "poses", "atlas", "mesh")]
    problem = load_problem(*folders, scene, settings.texture, len(drawn.light))
    held_out = held_out_photos(problem, work / "poses", work / "mesh", scene.observe.erode)

    start = time.process_time()
    with Bar(f"{work.name} {gloss}", units(settings)) as bar:
        scale_drawn = DrawFacts.load(sample).scale_drawn
        found, facts = refine(problem, drawn, settings, int(sample.name), bar, scale_drawn)
    row = {"cpu_seconds": time.process_time() - start}

    row |= score_held_out(problem, found, held_out, settings.score_pixels, settings.score_spp)
    metallic = gather(found.metallic, problem.observations.uv)
    row |= {"metal_share": float((metallic > 0.5).mean())}
    row |= {"rungs": [(b["chosen"], b["share"]) for b in facts.get("gloss", {}).get("bodies", [])]}
    if truth is not None:
        mesh = work / "atlas" / "mesh_uv.ply"
        renderer = Renderer(mesh, len(found.base_color), len(truth.known_light()), MAX_DEPTH)
        row |= {"truth": score_explanation(renderer, found, truth, SPP).values}
    return row


def rows_of(work: Path, scene: Scene, truth: Truth | None) -> list[dict]:
    """A row for each sample of a scene, with the scores of the plain textured mesh."""
    refine = scene.refine
    unlit, _ = score_unlit(work, refine.texture, scene.observe.erode, refine.score_pixels)
    means = {name: float(np.mean(list(views.values()))) for name, views in unlit.items()}
    rows = []
    for sample in sorted((work / "sample").iterdir()):
        made = {gloss: variant(work, scene, sample, gloss, truth) for gloss in VARIANTS}
        rows.append({"set": work.name, "sample": int(sample.name), "unlit": means, **made})
        print(json.dumps(rows[-1]), flush=True)
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--finished", type=Path, required=True, metavar="WORK")
    parser.add_argument("--sets", required=True, help="names with commas between")
    parser.add_argument("--truth", type=Path, metavar="SCENES")
    parser.add_argument("--preset", default="standard")
    parser.add_argument("--out", type=Path, required=True, help="JSON file for all rows")
    args = parser.parse_args()

    set_threads(1)
    rows = read_json(args.out)["rows"] if args.out.exists() else []
    for name in args.sets.split(","):
        if any(row["set"] == name for row in rows):
            continue
        scene = parse_scene({"photos": name, "preset": args.preset}, args.out)
        work = args.finished / name
        truth = truth_of_work(args.truth / name, work) if args.truth else None
        made = rows_of(work, scene, truth)
        rows += [row | {"preset": args.preset} for row in made]
        write_json(args.out, {"machine": machine(), "rows": rows})


if __name__ == "__main__":
    run_stage(main)
