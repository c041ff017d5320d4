"""The tables of README.md and docs/ from the committed rows in benchmarks/results/, so that none is
typed by hand.

python -m benchmarks.tables
    writes all tables anew
python -m benchmarks.tables --take rows.json pairs_split_gibbs --command "python -m ..." --note ...
    keeps what a benchmark wrote first

A table stands between the lines `<!-- table: NAME -->` and `<!-- end -->` of a page, and below it
the command, machine and commit of its rows.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from benchmarks.tables.committed import keep
from benchmarks.tables.pages import filled, pages
from pipeline.base.errors import run_stage
from pipeline.base.files import atomic_path


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--take", nargs=2, metavar=("FILE", "NAME"))
    parser.add_argument("--command", default="", help="what made FILE")
    parser.add_argument("--commit", default="", help="if not the one at hand")
    parser.add_argument("--machine", default="", help="if more is to be said than FILE does")
    parser.add_argument("--note", default="")
    args = parser.parse_args()
    if args.take:
        file, name = args.take
        keep(Path(file), name, args.command, args.commit, args.machine, args.note)
    for page in pages():
        text = filled(page)
        with atomic_path(page) as path:
            path.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    run_stage(main)
