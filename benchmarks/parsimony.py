"""No more model than the scene needs: the preset as it is, beside the same with the choose stage.

python -m benchmarks.parsimony --suite W --preset draft --out FOLDER
python -m benchmarks.parsimony --suite pairs --given SCENES --preset draft --out FOLDER
python -m benchmarks.parsimony --finished work --sets garden,banana --preset draft --out FOLDER
python -m benchmarks.parsimony --gather FOLDER rows.json

Of a procedural suite (benchmarks.suite.make, its scenes lie in FOLDER/scenes), of scenes whose
truth is known (SCENES/<scene>, by benchmarks.pairs), or of scenes that this code has made
(WORK/<set>), poses, mesh and atlas are taken; observations are made anew, and
choose, fit, sample and refine of --draws samples run twice: `fixed` with `choose: {enabled:
false}`, `chosen` with true. One thread each. FOLDER/work/<set>/<preset>/row.json is the row; what
is there is not made again, so a run that was cut off goes on. Settings of --with hold for both.

`numbers`: values that the exported asset of sample 0 carries in its maps and its light, a constant
map counting as one. `cpu_seconds`: processor time of choose, fit, and all samples and refinements;
the tables leave choose out where it chooses nothing.
`held_out_psnr`: dB over the held-out views of sample 0, with its standard error. Where the truth is
known, `truth`: scores of sample 0 (pipeline/render/declared.py), and with two draws or more, the
share of true values that their intervals hold.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml

from benchmarks.scenes import ROOT, machine, snakemake
from benchmarks.study import scenes
from benchmarks.study.rows import keep_pictures
from benchmarks.study.together import of_draws
from pipeline.base.config import load_scene, merge, slice_of
from pipeline.base.errors import InputError, nearest, run_stage
from pipeline.base.files import read_json, write_json
from pipeline.base.progress import progress
from pipeline.base.runtime import set_threads
from pipeline.posterior.choose.chosen import chosen_scene
from pipeline.render.renderer import Explanation, Renderer
from pipeline.report.score import MAX_DEPTH, score_explanation
from pipeline.report.truth import truth_of_work
from pipeline.usd.textures import constant_of

VARIANTS = {"fixed": False, "chosen": True}
GIVEN = ("poses", "mesh", "atlas")  # stages whose results are taken over
SPP = 64  # paths per pixel of pictures that are scored against the truth


@dataclass
class Job:
    """A scene: name; folders of the stages GIVEN; photos: its folder where the truth is known, else
    None. preset, settings: of both variants; draws: samples of each; variants: which of VARIANTS.
    """

    name: str
    folders: dict[str, Path]
    photos: Path | None
    preset: str
    settings: dict
    draws: int
    variants: tuple[str, ...] = tuple(VARIANTS)


def run_one(
    stage: str, config: Path, out: Path, folders: dict[str, Path], draw: int | None
) -> float:
    """Run a stage as a command, its log beside `out`. Returns its processor seconds; raises
    CalledProcessError where it fails.
    """
    words = [sys.executable, "-m", f"stages.{stage}", "--config", str(config), "--threads", "1"]
    for name, folder in folders.items():
        words += [f"--{name}", str(folder)]
    if draw is not None:
        words += ["--index", str(draw)]

    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    out.parent.mkdir(parents=True, exist_ok=True)
    with open(out.with_suffix(".log"), "w", encoding="utf-8") as log:
        subprocess.run(
            [*words, "--out", str(out)],
            cwd=ROOT,
            env=os.environ | {"OMP_NUM_THREADS": "1"},
            stdout=log,
            stderr=log,
            check=True,
        )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def made_by(
    stage: str, config: Path, out: Path, folders: dict[str, Path], draw: int | None = None
) -> float:
    """As `run_one`, once: processor seconds, kept beside `out`."""
    note = out.with_suffix(".cpu.json")
    if not (out / f"{stage}.json").exists() or not note.exists():
        write_json(note, {"cpu_seconds": run_one(stage, config, out, folders, draw)})
    return read_json(note)["cpu_seconds"]


def carried(x: Explanation) -> dict[str, int]:
    """How many numbers an asset holds, map by map."""
    count = {"base_color": x.base_color.size, "light": x.light.size}
    for name in ("roughness", "metallic"):
        image = getattr(x, name)
        count[name] = 1 if constant_of(image) is not None else image.size
    return count


def true_scores(job: Job, here: Path) -> dict:
    """Scores of sample 0 against the truth; and coverage, where there are several."""
    if job.photos is None:
        return {}
    truth = truth_of_work(job.photos, job.folders["poses"].parent)
    mesh = job.folders["atlas"] / "mesh_uv.ply"
    values = {}
    for k in range(job.draws):
        x = Explanation.load(here / "refine" / str(k))
        renderer = Renderer(mesh, len(x.base_color), len(truth.known_light()), MAX_DEPTH)
        scored = score_explanation(renderer, x, truth, SPP)
        keep_pictures(here / "pictures" / f"{k}.npz", scored, x)
        values.setdefault("truth", scored.values)
    if job.draws > 1:
        packs = [np.load(here / "pictures" / f"{k}.npz") for k in range(job.draws)]
        together = of_draws(packs, truth)
        values |= {key: together[key] for key in ("coverage", "within")}
    return values


def settled_alike(config: Path, choose: Path) -> bool:
    """Whether nothing that fit and samples read was chosen other than it is configured."""
    read = lambda scene: slice_of(scene, "render", "fit", "sample")
    scene = load_scene(config)
    return read(chosen_scene(scene, choose)) == read(scene)


def variant_row(job: Job, here: Path, folders: dict[str, Path], enabled: bool) -> dict:
    """Run the measured stages in the folder `here` and say what came out."""
    here.mkdir(parents=True, exist_ok=True)
    config = here / "scene.yaml"
    own = {"photos": "none", "preset": job.preset, "choose": {"enabled": enabled}}
    config.write_text(yaml.safe_dump(merge(job.settings, own)), encoding="utf-8")

    seconds = {"choose": made_by("choose", config, here / "choose", folders)}
    folders = folders | {"choose": here / "choose"}
    # with the settings of `fixed`, fit and samples are its own, bit for bit: made once
    drawn = here.parent / "fixed" if settled_alike(config, here / "choose") else here
    seconds["fit"] = made_by("fit", config, drawn / "fit", folders)
    for k in range(job.draws):
        sample, refine = drawn / "sample" / str(k), here / "refine" / str(k)
        by_fit, by_sample = folders | {"fit": drawn / "fit"}, folders | {"sample": sample}
        seconds[f"sample {k}"] = made_by("sample", config, sample, by_fit, k)
        seconds[f"refine {k}"] = made_by("refine", config, refine, by_sample, k)

    scored = read_json(here / "refine" / "0" / "refine.json")
    numbers = carried(Explanation.load(here / "refine" / "0"))
    chosen = read_json(here / "choose" / "choose.json")
    return {
        "numbers": sum(numbers.values()),
        "numbers_by_map": numbers,
        "cpu_seconds": sum(seconds.values()),
        "cpu_seconds_by_stage": seconds,
        "held_out_psnr": scored["held_out_psnr"],
        "held_out_standard_error": scored["held_out_standard_error"],
        "settings": chosen["settings"],
        "decisions": chosen["decisions"],
        "gloss": scored.get("gloss"),
        **true_scores(job, here),
    }


def make_row(job: Job, out: Path) -> Path:
    """The variants of a scene, and the file of its row."""
    here = out / "work" / job.name / job.preset
    row_file = here / "row.json"
    if row_file.exists():
        known = read_json(row_file)
        if known["draws"] >= job.draws and known.keys() >= set(job.variants):
            return row_file

    here.mkdir(parents=True, exist_ok=True)
    config = here / "scene.yaml"
    own = merge(job.settings, {"photos": "none", "preset": job.preset})
    config.write_text(yaml.safe_dump(own), encoding="utf-8")
    made_by("observe", config, here / "observe", job.folders)

    folders = job.folders | {"observe": here / "observe"}
    row: dict = {"set": job.name, "preset": job.preset, "with": job.settings, "draws": job.draws}
    for variant in job.variants:
        row[variant] = variant_row(job, here / variant, folders, VARIANTS[variant])
    write_json(row_file, row)
    return row_file


def given_folders(finished: Path, name: str) -> dict[str, Path]:
    """Raises InputError where WORK has not finished the set."""
    folders = {stage: finished / name / stage for stage in GIVEN}
    for folder in folders.values():
        if not folder.is_dir():
            raise InputError("this stage is not finished", folder, "correct --finished or --sets")
    return folders


def suite_folders(photos: Path) -> dict[str, Path]:
    """The stages GIVEN of a suite's scene, made in work/<scene> where they are not there."""
    name = photos.name
    if not (ROOT / "work" / name / "atlas" / "atlas.json").exists():
        snakemake(photos, [f"work/{name}/atlas/atlas.json"], ["preset=draft"])
    return given_folders(ROOT / "work", name)


def gathered(out: Path) -> dict:
    """All rows under `out`."""
    rows = [read_json(file) for file in sorted(out.glob("work/*/*/row.json"))]
    return {"machine": machine(), "rows": rows}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--suite", help="a procedural suite, made where it is not there")
    parser.add_argument("--given", type=Path, help="folder of scenes; --suite is then their name")
    parser.add_argument("--finished", type=Path, help="a work/ folder")
    parser.add_argument("--sets", help="names of its scenes, or of the suite's, with commas")
    parser.add_argument("--preset", default="standard", help="draft, standard or reference")
    parser.add_argument("--draws", type=int, default=1, help="samples of each scene")
    parser.add_argument("--with", type=json.loads, default={}, help="JSON: settings of both")
    parser.add_argument("--variants", default=",".join(VARIANTS), help="one of them, or both")
    parser.add_argument("--out", type=Path, help="FOLDER")
    parser.add_argument("--gather", type=Path, nargs=2, metavar=("FOLDER", "ROWS"))
    args = parser.parse_args()
    if args.gather:
        write_json(args.gather[1], gathered(args.gather[0]))
        return

    set_threads(1)
    variants = tuple(args.variants.split(","))
    if unknown := set(variants) - set(VARIANTS):
        name = unknown.pop()
        raise InputError(f"there is no variant '{name}'", "--variants", nearest(name, VARIANTS))
    out = args.out.resolve()
    same = (args.preset, vars(args)["with"], args.draws, variants)
    if args.suite:
        only = args.sets and args.sets.split(",")
        folders = scenes.scenes_of(args.suite, out / "scenes", args.given, only)
        for photos in progress(folders, "parsimony"):
            print(make_row(Job(photos.name, suite_folders(photos), photos, *same), out), flush=True)
        return
    for name in args.sets.split(","):
        job = Job(name, given_folders(args.finished.resolve(), name), None, *same)
        print(make_row(job, out), flush=True)


if __name__ == "__main__":
    run_stage(main)
