"""Peak memory of a finished scene's stages, in GiB: a row for each stage, a column for each folder.

python -m benchmarks.memory work/garden [../other/work/garden ...]

Each stage has noted its process's largest resident memory in its metrics; of several samples the
one that took most. Stages that a folder lacks are left empty there.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from benchmarks.chain_runs import peak_gib, stage_metrics
from benchmarks.markdown import number, pipe_table
from pipeline.base.errors import InputError, run_stage

ORDER = ("capture", "poses", "masks", "mesh", "atlas", "observe", "choose", "fit", "sample")
ORDER += ("refine", "export", "report")


def table(works: list[Path]) -> str:
    """The peaks of work folders side by side. Raises InputError where one holds no finished
    stage.
    """
    columns = [peak_gib(stage_metrics(work)) for work in works]
    for work, column in zip(works, columns):
        if not column:
            raise InputError(
                "no stage is finished there", work, "give a scene's folder below work/"
            )

    stages = [stage for stage in ORDER if any(stage in column for column in columns)]
    body = [[stage] + [number(column.get(stage), 2) for column in columns] for stage in stages]
    return pipe_table(["stage", *map(str, works)], body)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("works", type=Path, nargs="+", metavar="WORK/SCENE")
    print(table(parser.parse_args().works), end="")


if __name__ == "__main__":
    run_stage(main)
