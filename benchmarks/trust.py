"""The trust score: evidence of runs whose truth is known, the model fitted to it, and how well it
tells failures from the rest on kinds of scenes that it has not seen.

python -m benchmarks.trust --runs FOLDER --out rows.json     # evidence, truth of every run
python -m benchmarks.trust --rows rows.json                  # leave-scenes-out figures
python -m benchmarks.trust --rows rows.json --write          # and pipeline/report/trust.json

FOLDER is one of benchmarks.stability or benchmarks.trust_runs: work/, rows/ and draws/. A failure
is a run whose draws are worse than LIMIT dB under new light, in the mean. Leaving kinds out, the
model is fitted to all kinds of scenes but one (`kind_of`), and judges that one.
"""

from __future__ import annotations

import argparse
import re
from dataclasses import asdict
from pathlib import Path

import numpy as np
from scipy import optimize, stats

from benchmarks.scenes import machine
from benchmarks.stability.scenes import BASES
from benchmarks.study.methods import methods_named, scene_for
from pipeline.base.errors import InputError, run_stage
from pipeline.base.files import read_json, write_json
from pipeline.base.progress import progress
from pipeline.base.runtime import set_threads
from pipeline.geometry.cameras import load_cameras
from pipeline.posterior.load import load_problem
from pipeline.render.metrics import held_out_photos, score_held_out
from pipeline.render.renderer import Explanation
from pipeline.report.trust import MODEL, VERDICTS, Evidence, evidence

METHOD = "preset_draft"  # whose draws the model is fitted to: as users get them
LIMIT = 18.0  # dB of relit pictures
ALARM = VERDICTS[0][0]  # chance from which the report says not to rely on the asset
RIDGE = 3.0  # standard deviations of the weights' prior, as 1 / variance, on standardised evidence
PIXELS, SPP = 20_000, 32  # of held-out photos


def kind_of(scene: str) -> str:
    """What is hard about a scene, by its name: a knob of the stability suite on whatever base, or
    an object under whatever light. xs_vase_blur_1p5 -> blur, s_bowl__room_2 -> bowl.
    """
    stem = re.sub(r"^(xs|[sdw])_|__.*$|_m?\d[\dpem+-]*$", "", scene)
    return re.sub(rf"^({'|'.join(BASES)})_", "", stem)


def of_run(runs: Path, scene_name: str, method: str) -> dict | None:
    """The row of a scene's draws by a method, or None where they say nothing (`Evidence`)."""
    draws = drawn(runs, scene_name, method)
    rows = [read_json(runs / "rows" / scene_name / method / f"{path.name}.json") for path in draws]
    explanations = [Explanation.load(path) for path in draws]
    work = runs / "work" / scene_name
    scene = scene_for(method, str(runs / "scenes" / scene_name))

    first = explanations[0]
    at = {stage: work / stage for stage in ("observe", "poses", "atlas", "mesh")}
    problem = load_problem(*at.values(), scene, len(first.roughness), len(first.light))
    held = held_out_photos(problem, at["poses"], at["mesh"], scene.observe.erode)
    scored = [score_held_out(problem, x, held, PIXELS, SPP)["held_out_psnr"] for x in explanations]
    known = [score for score in scored if score is not None]

    rig = load_cameras(at["poses"] / "cameras.json")
    found = evidence(work, rig, explanations, scene, known)
    if found is None:
        return None
    relight = float(np.mean([row["scores"]["relight_psnr"] for row in rows]))
    return {
        "scene": scene_name,
        "method": method,
        "draws": len(draws),
        "evidence": asdict(found),
        "relight_psnr": relight,
    }


def drawn(runs: Path, scene_name: str, method: str) -> list[Path]:
    """The draws of a scene that are there, by their seeds."""
    folder = runs / "draws" / scene_name / method
    found = [path for path in folder.glob("*") if path.is_dir() and path.name.isdecimal()]
    return sorted(found, key=lambda path: int(path.name))


def gathered(folders: list[Path], out: Path, method: str) -> dict:
    """Rows of all runs that have draws by a method, kept in `out` one after the other: scenes that
    are there are not gathered again.
    """
    runs = [(folder, path.name) for folder in folders for path in (folder / "draws").iterdir()]
    complete = [(folder, name) for folder, name in sorted(runs) if drawn(folder, name, method)]
    known = read_json(out) if out.exists() else {"rows": [], "without_evidence": []}
    rows, without = known["rows"], known["without_evidence"]
    done = {row["scene"] for row in rows} | set(without)
    for folder, name in progress([run for run in complete if run[1] not in done], "runs"):
        row = of_run(folder, name, method)
        if row is None:
            without.append(name)
        else:
            rows.append(row)
        write_json(out, {"rows": rows, "without_evidence": without, "machine": machine()})
    return read_json(out)


def fitted(rows: list[dict]) -> dict:
    """The model of pipeline/report/trust.py: logistic regression with a ridge."""
    x = np.array([Evidence(**row["evidence"]).vector() for row in rows])
    failed = np.array([row["relight_psnr"] < LIMIT for row in rows])
    if failed.all() or not failed.any():
        raise InputError("all runs fail, or none", "rows", "gather runs of both kinds")
    mean, spread = x.mean(0), np.maximum(x.std(0), 1e-6)
    z = (x - mean) / spread
    sign = np.where(failed, 1.0, -1.0)

    def loss(w: np.ndarray) -> float:
        return np.logaddexp(0, -sign * (w[0] + z @ w[1:])).sum() + 0.5 * RIDGE * (w[1:] ** 2).sum()

    w = optimize.minimize(loss, np.zeros(1 + z.shape[1])).x
    weights = w[1:] / spread
    return {
        "limit": LIMIT,
        "intercept": float(w[0] - weights @ mean),
        "weights": weights.tolist(),
        "usual": np.median(x[~failed], axis=0).tolist(),
    }


def chances(model: dict, rows: list[dict]) -> np.ndarray:
    x = np.array([Evidence(**row["evidence"]).vector() for row in rows])
    return 1 / (1 + np.exp(-(model["intercept"] + x @ np.array(model["weights"]))))


def kinds_of(rows: list[dict]) -> np.ndarray:
    return np.array([kind_of(row["scene"]) for row in rows])


def left_out(rows: list[dict]) -> np.ndarray:
    """Of every run, the chance by a model that has seen no run of its kind (n,)."""
    kinds = kinds_of(rows)
    out = np.zeros(len(rows))
    for kind in sorted(set(kinds)):
        seen = fitted([row for row, other in zip(rows, kinds != kind) if other])
        out[kinds == kind] = chances(seen, [row for row, mine in zip(rows, kinds == kind) if mine])
    return out


def auroc(chance: np.ndarray, failed: np.ndarray) -> float:
    """Probability that a failure has a greater chance than a success, ties counted half."""
    bad, good = chance[failed], chance[~failed]
    return float(stats.mannwhitneyu(bad, good).statistic / (len(bad) * len(good)))


def figures(rows: list[dict]) -> dict:
    """AUROC and calibration, by leave-scenes-out, with a bootstrap interval over kinds."""
    failed = np.array([row["relight_psnr"] < LIMIT for row in rows])
    chance = left_out(rows)
    kinds = kinds_of(rows)
    names = np.array(sorted(set(kinds)))
    rng = np.random.default_rng(0)
    again = []
    while len(again) < 1000:
        index = np.concatenate([np.flatnonzero(kinds == k) for k in rng.choice(names, len(names))])
        if 0 < failed[index].sum() < len(index):
            again.append(auroc(chance[index], failed[index]))
    return {
        "runs": len(rows),
        "kinds": len(names),
        "failures": int(failed.sum()),
        "auroc": auroc(chance, failed),
        "auroc_interval": np.quantile(again, [0.025, 0.975]).tolist(),
        "brier": float(((chance - failed) ** 2).mean()),
        "failures_found": float((chance[failed] >= ALARM).mean()),
        "false_alarms": float((chance[~failed] >= ALARM).mean()),
        "chance": dict(zip([row["scene"] for row in rows], chance.round(3).tolist())),
    }


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--runs", type=Path, nargs="+", help="folders of benchmarks.stability")
    parser.add_argument("--method", default=METHOD, help="whose draws are looked at")
    parser.add_argument("--out", type=Path, help="JSON file for rows; new ones are added")
    parser.add_argument("--rows", type=Path, help="rows that are there")
    parser.add_argument("--write", action="store_true", help="write pipeline/report/trust.json")
    args = parser.parse_args()
    if bool(args.runs) == bool(args.rows) or (args.runs and not args.out):
        raise InputError("give --runs and --out, or --rows", "benchmarks.trust", "see --help")
    if args.runs:
        set_threads(1)
        gathered(args.runs, args.out, *methods_named([args.method]))
        return
    rows = read_json(args.rows)["rows"]
    for name, value in figures(rows).items():
        print(f"{name}: {value}")
    if args.write:
        write_json(MODEL, fitted(rows))


if __name__ == "__main__":
    run_stage(main)
