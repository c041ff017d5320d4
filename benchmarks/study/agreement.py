"""The study's figures beside those of `heliograph score` on the same draws.

python -m benchmarks.study.agreement --suite XS --methods map,split_gibbs_draft --out FOLDER

FOLDER is that of `benchmarks.study`; FOLDER/agreement.json gets the rows, each of which lies in a
file below FOLDER/agreement first, so that a run that was cut off goes on. A method's first draw of
a scene is made and scored as the study does it, exported, and scored from its USD alone, with as
many paths and with twice as many. The two scores of one file differ by the path tracer's noise;
what the first one differs from the study by is what an export rounds, 8-bit textures.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from benchmarks.scenes import ROOT, machine
from benchmarks.study.__main__ import prepare
from benchmarks.study.agreement_table import table
from benchmarks.study.methods import methods_named
from benchmarks.study.rows import SPP, measure
from benchmarks.study.scenes import scenes_of
from benchmarks.study.store import row_file
from pipeline.base.errors import run_stage
from pipeline.base.files import read_json, write_json
from pipeline.base.progress import progress
from pipeline.base.runtime import set_threads
from pipeline.report.score import score_asset
from pipeline.report.truth import truth_of_work
from pipeline.usd.write import export


def compared(scene: Path, method: str, out: Path) -> dict:
    """Scores of a method's first draw of a scene's folder, from the study and from its export; kept
    in a file of their own, and not made again.
    """
    work = ROOT / "work"
    rows, kept = out / "agreement", out / "kept"
    file = rows / scene.name / f"{method}.json"
    if file.exists():
        return read_json(file)
    measure(method, scene, work, [0], rows, rows, keep=kept)
    row = read_json(row_file(rows, scene.name, method, 0))

    usd = out / "exports" / f"{scene.name}_{method}.usda"
    draw = kept / scene.name / method / "0"
    export(work / scene.name / "atlas", [draw], usd, {"sampler": method})
    truth = truth_of_work(scene, work / scene.name)
    score = lambda spp: score_asset(usd, truth, spp)["samples"]
    once, twice = score(SPP), score(2 * SPP)
    (name,) = once
    found = {"scene": scene.name, "method": method, "commit": row["commit"]}
    found |= {"study": row["scores"], "score": once[name]["scores"]}
    write_json(file, found | {"score_twice": twice[name]["scores"]})
    return read_json(file)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--suite", default="XS")
    parser.add_argument("--methods", default="map,split_gibbs_draft", help="with commas between")
    parser.add_argument("--out", type=Path, required=True)
    args = parser.parse_args()
    set_threads(1)
    scenes = scenes_of(args.suite, args.out / "scenes")
    for folder in scenes:
        prepare(folder)
    jobs = [(folder, m) for m in methods_named(args.methods.split(",")) for folder in scenes]
    rows = [compared(folder, method, args.out) for folder, method in progress(jobs, "agreement")]
    write_json(args.out / "agreement.json", {"machine": machine(), "rows": rows})
    print(table(rows))


if __name__ == "__main__":
    run_stage(main)
