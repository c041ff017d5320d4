"""Peak memory of finished scenes' stages, in GiB: a row for each stage, a column for each folder.

python -m benchmarks.memory today=work/garden before=../other/work/garden --out rows.json

Each stage has noted its process's largest resident memory in its metrics; of several samples the
one that took most. Stages that a folder lacks are left empty there.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from benchmarks.chain_runs import peak_gib, stage_metrics
from benchmarks.markdown import number, pipe_table
from benchmarks.scenes import machine
from pipeline.base.errors import InputError, run_stage
from pipeline.base.files import write_json

ORDER = ("capture", "poses", "masks", "mesh", "atlas", "observe", "choose", "fit", "sample")
ORDER += ("refine", "enough", "export", "report")


def peaks(name: str, work: Path) -> dict:
    """A column of the table: the peaks of a work folder's stages, under a name. Raises InputError
    where no stage is finished.
    """
    found = peak_gib(stage_metrics(work))
    if not found:
        raise InputError("no stage is finished there", work, "give a scene's folder below work/")
    return {"name": name, "peak_gib": found}


def table(columns: list[dict]) -> str:
    """Columns of `peaks` side by side."""
    found = [column["peak_gib"] for column in columns]
    stages = [stage for stage in ORDER if any(stage in column for column in found)]
    body = [[stage] + [number(column.get(stage), 2) for column in found] for stage in stages]
    return pipe_table(["stage", *(column["name"] for column in columns)], body)


def named_folder(text: str) -> tuple[str, Path]:
    """NAME=FOLDER of the command line. Raises InputError for anything else."""
    name, equals, folder = text.partition("=")
    if not (name and equals and folder):
        raise InputError(f"expected NAME=FOLDER, got '{text}'", "", "as in before=work/garden")
    return name, Path(folder)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("works", nargs="+", metavar="NAME=WORK/SCENE")
    parser.add_argument("--out", type=Path, help="JSON file for all columns")
    args = parser.parse_args()
    columns = [peaks(*named_folder(text)) for text in args.works]
    print(table(columns), end="")
    if args.out:
        write_json(args.out, {"machine": machine(), "rows": columns})


if __name__ == "__main__":
    run_stage(main)
