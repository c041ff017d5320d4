"""The command `heliograph`: doctor, check."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from pipeline import __version__
from pipeline.base.errors import run_stage


def _run() -> None:
    parser = argparse.ArgumentParser(
        prog="heliograph",
        description="Photos in, relightable USD out. The work itself: snakemake "
        "--cores 2 exports/<scene>.usda",
    )
    parser.add_argument("--version", action="version", version=__version__)
    commands = parser.add_subparsers(dest="command", required=True)
    commands.add_parser("doctor", help="is everything installed, and does it work?")
    checker = commands.add_parser("check", help="run the USD validators over files")
    checker.add_argument("files", nargs="+", type=Path)
    args = parser.parse_args()
    if args.command == "doctor":
        from pipeline.run.doctor import doctor

        sys.exit(0 if doctor() else 1)
    from pipeline.usd.check import check

    problems = [p for f in args.files for p in check(f)]
    print("\n".join(problems) if problems else f"{len(args.files)} file(s): no problems")
    sys.exit(1 if problems else 0)


def main() -> None:
    """Entry point; a user's mistake becomes a plain message."""
    run_stage(_run)


if __name__ == "__main__":
    main()
