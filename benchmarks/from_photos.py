"""From photos alone to views under new light, on rendered things whose truth is known.

python -m benchmarks.from_photos --scenes FOLDER/* --preset standard --out rows.json

Each scene folder, as benchmarks.make_scene writes them, goes through the whole chain twice:
`given`, as it is, with its true mesh; and `own`, without, so that the surface is made from the
photos (one of them: --surfaces own). What the own surface costs under new light is the difference.
Cameras and masks are given both times.
What is up to date is not made again, so a run that was cut off goes on.

A row: `scene`; `surface`, own or given; `photos`, the figures of `benchmarks.unlit` (held-out
views, beside the plain textured mesh); `truth`, the scores of all samples and of their mean
(pipeline/render/declared.py); `trust`, what the report says of the run; of the own surface `method`
and `geometry`, its errors against the true one (`benchmarks.geometry`).
"""

from __future__ import annotations

import argparse
import shutil
from pathlib import Path

from benchmarks import unlit
from benchmarks.geometry import compare
from benchmarks.mean_of_samples import samples_in, with_mean
from benchmarks.scenes import ROOT, machine, run
from pipeline.base.config import Observe
from pipeline.base.errors import InputError, run_stage
from pipeline.base.files import read_json, stage_folder, write_json
from pipeline.base.runtime import set_threads
from pipeline.render.renderer import Renderer
from pipeline.report.score import MAX_DEPTH, score_explanation
from pipeline.report.truth import truth_of_work

OWN = "own"
GIVEN = "given"
CAMERAS = ("transforms.json", "transforms_test.json")  # train and test
SAMPLES = 2
SPP = 32  # paths per pixel of pictures that are scored against the truth


def without_mesh(folder: Path) -> Path:
    """work/sets/<name>_own: photos, masks and cameras of a scene folder; and truth/cameras.json,
    all its cameras in one file.

    Raises InputError where the folder has no truth.
    """
    if not (folder / "truth" / "relight").is_dir() or not (folder / "mesh.ply").exists():
        cure = "name folders that benchmarks.make_scene made"
        raise InputError("its truth is not known", folder, cure)
    out = ROOT / "work" / "sets" / f"{folder.name}_{OWN}"
    if (out / "images").exists():
        return out
    with stage_folder(out, "images") as partial:
        for kind in ("images", "masks"):
            shutil.copytree(folder / kind, partial / kind)
        for name in CAMERAS:
            shutil.copy2(folder / name, partial / name)
        frames = [frame for name in CAMERAS for frame in read_json(folder / name)["frames"]]
        (partial / "truth").mkdir()
        write_json(partial / "truth" / "cameras.json", {"frames": frames})
    return out


def against_truth(folder: Path, work: Path) -> dict:
    """Scores of the `samples` of a finished run in `work`, and of their `mean`."""
    truth = truth_of_work(folder, work)
    mesh, rows = work / "atlas" / "mesh_uv.ply", len(truth.known_light())
    scored = []
    for x in with_mean(samples_in(work / "refine")):
        renderer = Renderer(mesh, len(x.base_color), rows, MAX_DEPTH)
        scored.append(score_explanation(renderer, x, truth, SPP).values)
    return {"samples": scored[:-1], "mean": scored[-1]}


def row_of(folder: Path, made_from: Path) -> dict:
    """The row of a finished run. folder: with the truth; made_from: what the chain read."""
    work = ROOT / "work" / made_from.name
    surface = GIVEN if made_from == folder else OWN
    row = {
        "scene": folder.name,
        "surface": surface,
        "photos": unlit.row(work, Observe().erode),
        "truth": against_truth(folder, work),
        "trust": read_json(work / "report.json")["trust"],
    }
    if surface == OWN:
        mesh, cameras = work / "atlas" / "mesh_uv.ply", work / "poses" / "cameras.json"
        true = folder / "mesh.ply", made_from / "truth" / "cameras.json"
        facts = read_json(work / "mesh" / "mesh.json")
        row |= {key: facts[key] for key in ("method", "why", "faces")}
        row["geometry"] = compare(mesh, cameras, *true)
    return row


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--scenes", type=Path, nargs="+", required=True, help="scene folders")
    parser.add_argument("--preset", default="standard")
    parser.add_argument("--surfaces", nargs="+", choices=(OWN, GIVEN), default=(OWN, GIVEN))
    parser.add_argument("--samples", type=int, default=SAMPLES)
    parser.add_argument("--out", type=Path, required=True, help="JSON file for all rows")
    args = parser.parse_args()

    rows = read_json(args.out)["rows"] if args.out.exists() else []
    done = {(row["scene"], row["surface"]) for row in rows}
    set_threads(2)
    for folder in (path.resolve() for path in args.scenes):
        for surface in args.surfaces:
            if (folder.name, surface) in done:
                continue
            made_from = without_mesh(folder) if surface == OWN else folder
            run(made_from, args.preset, args.samples, [])
            rows.append(row_of(folder, made_from))
            about = {"machine": machine(), "preset": args.preset, "rows": rows}
            write_json(args.out, about)


if __name__ == "__main__":
    run_stage(main)
