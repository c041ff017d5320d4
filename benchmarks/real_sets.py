"""Real photo sets through the whole chain, each beside the yardstick of `benchmarks.unlit`.

python -m benchmarks.real_sets --photos FOLDER --sets banana,brass_head --out rows.json

FOLDER/<set> is a scene folder (docs/scene_folder.md); `garden` is the shipped example. Each becomes
the scene of its own name at preset `standard`; of sets in PARTS only some photos are used, and are
copied to work/sets/<set> first. Where the truth is known, the row has errors of surface and normals
(`benchmarks.geometry`, `benchmarks.normals`). What is up to date is not made again, so a run that
was cut off goes on. A set that fails leaves a row that says so, and the others go on.

With --finished WORK the scenes of another checkout's work/ are scored, by the code at hand.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
from pathlib import Path

from benchmarks import unlit
from benchmarks.geometry import compare
from benchmarks.normals import PICTURE_END, picture_scores
from benchmarks.scenes import ROOT, machine, run
from pipeline.base.config import Observe
from pipeline.base.errors import InputError, run_stage
from pipeline.base.files import read_json, stage_folder, write_json

SETS = (
    "garden",
    "kitchen_bulldozer",
    "banana",
    "brass_head",
    "marble_head_livia",
    "nerf_lego",
    "socketed_axe",
)
# Photos from the first name to the last one: between two passes the object was turned over.
PARTS = {"socketed_axe": ("IMG_8835", "IMG_8860")}
# A turntable's light moves with the camera: the chain refuses it unless told to go on.
OPTIONS = {"socketed_axe": ["poses={moving_light: accept}"]}
STOPPED = "Heliograph cannot go on."  # how a stage begins to say what it lacks
GARDEN = "garden"  # the shipped example, whose truth is known
GARDEN_ABOVE = 0.004  # metres: below it is the underside, which no photo shows


def part_of(folder: Path, first: str, last: str) -> Path:
    """work/sets/<name of folder> with the photos `first` to `last` of `folder` and their masks.

    Raises InputError where there are none.
    """
    out = ROOT / "work" / "sets" / folder.name
    count = 0
    with stage_folder(out, "images") as partial:
        for kind in ("images", "masks"):
            (partial / kind).mkdir()
            for file in sorted((folder / kind).glob("*")):
                if first <= file.stem <= last:
                    shutil.copy2(file, partial / kind / file.name)
                    count += kind == "images"
        if not count:
            raise InputError(f"no photos from {first} to {last}", folder, "correct --photos")
    return out


def scene_folder(photos: Path, name: str) -> Path:
    """The scene folder of a set. Raises InputError where it is missing."""
    folder = ROOT / "examples" / GARDEN if name == GARDEN else photos / name
    if not folder.is_dir():
        raise InputError("there is no such set", folder, "correct --photos or --sets")
    return part_of(folder, *PARTS[name]) if name in PARTS else folder


def against_truth(folder: Path, work: Path) -> dict:
    """Errors of a scene's surface and normals, as far as its folder has the truth."""
    mesh = work / "atlas" / "mesh_uv.ply"  # beside it lies the normal map
    cameras = work / "poses" / "cameras.json"
    truth = folder / "truth"
    if folder.name == GARDEN:
        true_cameras = truth / "transforms_truth.json"
        return compare(mesh, cameras, truth / "mesh.ply", true_cameras, above=GARDEN_ABOVE)

    if list(folder.glob(f"*/*{PICTURE_END}")):
        return picture_scores(mesh, cameras, folder)
    return {}


def figures(folder: Path, work: Path) -> dict:
    """One finished set: what its stages say, the figures of `benchmarks.unlit`, and the errors
    against the truth.

    folder: the set's; work: the folder that its stages wrote to.
    """
    poses, masks, mesh = (read_json(work / s / f"{s}.json") for s in ("poses", "masks", "mesh"))
    around = read_json(work / "observe" / "observe.json").get("tint_around")
    facts = {
        "around_warm": around[0] if isinstance(around, list) else None,
        "photos": f"{poses['registered']}/{poses['photos']}",
        "masks": masks["method"],
        "mesh": mesh["method"],
        "stereo_share": mesh.get("depth_share", mesh.get("stereo_share")),
        "parts": mesh.get("parts"),
        "warnings": mesh.get("warnings", []),
    }
    truth = against_truth(folder, work)
    return unlit.row(work, Observe().erode) | facts | {"truth": truth}


def failure(logs: Path) -> str:
    """Why the chain stopped: the stage whose log of `logs` is newest, and what it said last."""
    files = list(logs.glob("*.log"))
    if not files:
        return "no stage was begun: see what Snakemake said"
    newest = max(files, key=lambda file: file.stat().st_mtime)
    lines = [line.strip() for line in newest.read_text(encoding="utf-8").splitlines()]
    said = [line for line in lines if line] or ["no word"]
    if STOPPED in said[:-1]:
        said = [said[said.index(STOPPED) + 1].split(": ", 1)[-1]]  # without the place, a path
    return f"{newest.stem}: {said[-1]}"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--photos", type=Path, required=True)
    parser.add_argument("--sets", default=",".join(SETS), help="names with commas between")
    parser.add_argument("--preset", default="standard")
    parser.add_argument("--samples", type=int, default=2)
    parser.add_argument("--set", nargs="*", default=[], help="more settings, key=value")
    parser.add_argument("--out", type=Path, required=True, help="JSON file for all rows")
    parser.add_argument(
        "--finished",
        type=Path,
        help="a work/ of another checkout: score what is there, run nothing",
    )
    args = parser.parse_args()

    rows = []
    for name in args.sets.split(","):
        folder = scene_folder(args.photos, name)
        try:
            if not args.finished:
                run(folder, args.preset, args.samples, args.set + OPTIONS.get(name, []))
            work = (args.finished or ROOT / "work") / name
            rows.append(figures(folder, work))
        except subprocess.CalledProcessError:
            rows.append({"scene": name, "failed": failure(ROOT / "work" / name / "logs")})
        print(json.dumps(rows[-1]), flush=True)
        write_json(args.out, {"machine": machine(), "preset": args.preset, "rows": rows})


if __name__ == "__main__":
    run_stage(main)
