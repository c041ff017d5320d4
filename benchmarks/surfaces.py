"""Speed against accuracy of the surface: the garden photos' mesh at several settings.

python -m benchmarks.surfaces --out FOLDER                      # ten minutes of one core
python -m benchmarks.surfaces --out FOLDER --gather rows.json
python -m benchmarks.surfaces --chart benchmarks/results/surfaces.json --to docs

Cameras and masks are those of preset `standard`, made once; every setting of SETTINGS then makes
mesh, atlas and normal map from them, on one thread. `core_seconds`: processor time of these stages
(`mesh`, `atlas`; the workflow's own start of two seconds counts). Scores: `benchmarks.geometry`
against the true mesh, and `benchmarks.unlit`, the plain textured mesh on held-out photos.
FOLDER/rows gets one file a setting; what is there is not made again.
"""

from __future__ import annotations

import argparse
import shutil
from pathlib import Path

import yaml
from matplotlib.axes import Axes

from benchmarks.chain_runs import rows_at_hand, run_chain
from benchmarks.figures import STYLE, matplotlib, pyplot, saved
from benchmarks.real_sets import GARDEN, against_truth
from benchmarks.scenes import ROOT
from benchmarks.study.front import front
from benchmarks.surfaces_tables import SCORES, points
from benchmarks.tables.committed import head_commit
from benchmarks.unlit import mean, score_unlit
from pipeline.base.config import Observe, merge
from pipeline.base.errors import InputError, run_stage
from pipeline.base.files import read_json, write_json
from pipeline.base.progress import progress

PHOTOS = ROOT / "examples" / GARDEN
TEXTURE = 1024  # of the plain textured mesh
SECONDS = (50, 100, 200, 400)  # ticks of the chart
SHARED = "masks"  # the last stage that all settings share


def of_preset(name: str) -> dict:
    """The sections `mesh` and `atlas` of a preset."""
    found = yaml.safe_load((ROOT / "configs" / "presets" / f"{name}.yaml").read_text("utf-8"))
    return {section: found[section] for section in ("mesh", "atlas") if section in found}


def settings_by_name() -> dict[str, dict]:
    """What every setting changes of preset `standard`."""
    return {
        "hull": {"mesh": {"method": "hull"}},
        "draft": of_preset("draft"),
        "no refinement": {"mesh": {"refine_steps": 0}},
        "standard": {},
        "reference": of_preset("reference"),
    }


def target(stage: str) -> list[str]:
    return [f"work/{GARDEN}/{stage}/{stage}.json"]


def shared(out: Path) -> Path:
    """The project with cameras and masks, made where it is not there."""
    project = out / "shared"
    if not (project / target(SHARED)[0]).exists():
        run_chain(project, GARDEN, {"photos": str(PHOTOS)}, target(SHARED))
    return project


def row(name: str, changes: dict, out: Path) -> dict:
    """One setting's surface: what it took, and how good it is."""
    project = out / "projects" / name.replace(" ", "_")
    if project.exists():  # of a run that was cut off: what it has made would not be counted
        shutil.rmtree(project)
    shutil.copytree(shared(out), project)
    settings = merge({"photos": str(PHOTOS)}, changes)
    seconds = run_chain(project, GARDEN, settings, target("atlas"))
    run_chain(project, GARDEN, settings, target("observe"))

    work = project / "work" / GARDEN
    unlit, _ = score_unlit(work, TEXTURE, Observe().erode)
    mesh = read_json(work / "mesh" / "mesh.json")
    return {
        "setting": name,
        "settings": changes,
        "core_seconds": seconds,
        "seconds": {s: read_json(work / s / f"{s}.json")["seconds"] for s in ("mesh", "atlas")},
        "peak_gib": mesh["peak_gib"],
        "method": mesh["method"],
        "faces": read_json(work / "atlas" / "atlas.json")["faces"],
        "unlit_psnr": mean(list(unlit["robust"].values())),
        "truth": against_truth(PHOTOS, work),
        "commit": head_commit(),
    }


def panel(axes: Axes, data: dict, name: str) -> None:
    """One score against seconds; dashed: nothing is both faster and better."""
    settings = points(data, name)
    best = front(settings, True)
    steps = {"drawstyle": "steps-post", "color": "#777777", "lw": 1}
    axes.plot([p.seconds for p in best], [p.value for p in best], "--", **steps)
    for point in settings:
        at = (point.seconds, point.value)
        axes.plot(*at, "o", color="#b4500f", ms=5)
        # out of the way of one that takes hardly longer
        below = any(1 < other.seconds / point.seconds < 1.3 for other in settings)
        place = {"xytext": (4, -11 if below else 5), "textcoords": "offset points"}
        axes.annotate(point.method, at, fontsize=7, ha="right" if below else "left", **place)
    axes.set(xscale="log")
    axes.set_xticks(SECONDS, [str(tick) for tick in SECONDS])
    axes.minorticks_off()
    axes.set_title(SCORES[name], fontsize=9)
    axes.set_xlabel("core seconds, mesh and atlas")
    axes.margins(0.2, 0.15)


def chart(data: dict, out: Path) -> None:
    """`out`.svg and `out`.png."""
    with matplotlib.rc_context(STYLE):
        figure, line = pyplot.subplots(1, len(SCORES), figsize=(10, 3), layout="constrained")
        for axes, name in zip(line, SCORES):
            panel(axes, data, name)
        saved(figure, out, dpi=120)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, help="FOLDER")
    parser.add_argument("--gather", type=Path, help="run nothing; JSON file for all rows")
    parser.add_argument("--chart", type=Path, help="run nothing; JSON file of the rows to chart")
    parser.add_argument("--to", type=Path, default=Path("docs"), help="folder of the chart")
    args = parser.parse_args()
    if args.chart:
        found = read_json(args.chart)
        chart(found.get("data", found), args.to / "surfaces")
        return
    if not args.out:
        raise InputError("no folder for the rows", "--out", "say --out FOLDER")
    out = args.out.resolve()
    if args.gather:
        files = sorted((out / "rows").glob("*.json"))
        write_json(args.gather, rows_at_hand(files, out / "rows"))
        return

    file = lambda name: out / "rows" / f"{name.replace(' ', '_')}.json"
    due = [(name, one) for name, one in settings_by_name().items() if not file(name).exists()]
    for name, changes in progress(due, "surfaces"):
        write_json(file(name), row(name, changes, out))


if __name__ == "__main__":
    run_stage(main)
