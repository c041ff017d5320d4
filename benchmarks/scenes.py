"""Run the whole chain on several scene folders and print one table row each.

python -m benchmarks.scenes --preset draft --samples 2 FOLDER [FOLDER ...]

Each folder (see docs/scene_folder.md) becomes the scene of its own name; its configuration is
written to configs/<name>.yaml for the run if there is none, and removed afterwards.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
from pathlib import Path

from pipeline.base.errors import run_stage
from pipeline.base.files import read_json, write_json
from pipeline.run.workflow import checked_name

ROOT = Path(__file__).resolve().parent.parent
# for a fit that several methods share: as much work as the preset says, whatever the scene needs
AS_CONFIGURED = "choose={enabled: false}"


def machine() -> str:
    """What rows say of the machine they were made on: times of two machines are not compared."""
    return ", ".join([platform.machine(), f"{os.cpu_count()} cores", *processor()])


def processor() -> list[str]:
    """The processor's model in a list, which is empty where the system does not name it."""
    facts = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    return [line.partition(": ")[2] for line in facts if line.startswith("model name")][:1]


def snakemake(folder: Path, targets: list[str], settings: list[str]) -> None:
    """Make `targets` of the scene in `folder`, under a configuration of its own if there is none of
    its name. Raises InputError when the folder's name cannot be a scene's.
    """
    config = ROOT / "configs" / f"{checked_name(folder.name)}.yaml"
    made = not config.exists()
    if made:
        config.write_text(
            f"photos: {json.dumps(str(folder.resolve()), ensure_ascii=False)}\n", encoding="utf-8"
        )
    try:
        command = [
            sys.executable,
            "-m",
            "snakemake",
            "--cores",
            "2",
            *targets,
            "--config",
            *settings,
        ]
        subprocess.run(command, cwd=ROOT, check=True, stdout=subprocess.DEVNULL)
    finally:
        if made:
            config.unlink()


def run(folder: Path, preset: str, samples: int, extra: list[str]) -> dict:
    """One scene through Snakemake; the metrics that matter."""
    name = folder.name
    snakemake(
        folder,
        [f"exports/{name}.usda", f"exports/{name}_report.html"],
        [f"preset={preset}", f"samples={samples}", *extra],
    )
    return collect(name, samples)


def collect(name: str, samples: int) -> dict:
    """Metrics that the stages of a finished scene wrote."""
    work = ROOT / "work" / name
    facts = {
        s: read_json(work / s / f"{s}.json")
        for s in ("capture", "poses", "masks", "mesh", "atlas", "observe", "fit")
    }
    refined = [read_json(work / "refine" / str(k) / "refine.json") for k in range(samples)]
    drawn = [read_json(work / "sample" / str(k) / "sample.json") for k in range(samples)]
    scores = [r["held_out_psnr"] for r in refined if r["held_out_psnr"] is not None]
    everything = (
        list(facts.values())
        + refined
        + drawn
        + [read_json(work / "export.json"), read_json(work / "report.json")]
    )
    return {
        "scene": name,
        "photos": f"{facts['poses']['registered']}/{facts['poses']['photos']}",
        "masks": facts["masks"]["method"],
        "mesh": facts["mesh"]["method"],
        "stereo_share": facts["mesh"].get("depth_share"),
        "samples": samples,
        "held_out_psnr": sum(scores) / len(scores) if scores else None,
        "seconds": {s: f["seconds"] for s, f in facts.items()}
        | {
            "sample": max(d["seconds"] for d in drawn),
            "refine": max(r["seconds"] for r in refined),
        },
        "sum_of_stage_seconds": sum(f["seconds"] for f in everything),
        "peak_gib": max(f["peak_gib"] for f in everything),
    }


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folders", type=Path, nargs="+")
    parser.add_argument("--preset", default="draft")
    parser.add_argument("--samples", type=int, default=2)
    parser.add_argument("--out", type=Path, help="JSON file for all rows")
    parser.add_argument("--set", nargs="*", default=[], help="more settings, key=value")
    args = parser.parse_args()
    rows = []
    for folder in args.folders:
        try:
            rows.append(run(folder, args.preset, args.samples, args.set))
        except subprocess.CalledProcessError as error:
            rows.append(
                {
                    "scene": folder.name,
                    "failed": f"exit status {error.returncode}; see work/{folder.name}/logs",
                }
            )
        print(json.dumps(rows[-1]), flush=True)
    if args.out:
        write_json(
            args.out,
            {
                "machine": machine(),
                "preset": args.preset,
                "rows": rows,
            },
        )


if __name__ == "__main__":
    run_stage(main)
