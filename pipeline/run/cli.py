"""The command `heliograph`: doctor, check, score."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from pipeline import __version__
from pipeline.base.errors import InputError, run_stage


def _score(asset: Path, truth: Path, spp: int, out: Path | None) -> None:
    """Print the table of an asset's scores; the same as JSON into `out`, else below the table."""
    from pipeline.base.files import write_json
    from pipeline.report.score import score_asset, table
    from pipeline.report.truth import load_truth

    if spp < 2 or spp % 2:
        raise InputError(f"{spp} paths per pixel", "--spp", "give an even number from 2 on")
    scored = score_asset(asset, load_truth(truth), spp)
    print(table(scored))
    if out is None:
        print(json.dumps(scored))
    else:
        write_json(out, scored)


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
    scorer = commands.add_parser("score", help="score a finished asset where the truth is known")
    scorer.add_argument("asset", type=Path, help=".usda, .usd or .usdz, any tool's")
    scorer.add_argument("--truth", type=Path, required=True, help="scene folder with truth/")
    scorer.add_argument("--spp", type=int, default=128, help="paths per pixel")
    scorer.add_argument("--out", type=Path, help="JSON file for the scores")
    args = parser.parse_args()
    if args.command == "doctor":
        from pipeline.run.doctor import doctor

        sys.exit(0 if doctor() else 1)
    if args.command == "score":
        _score(args.asset, args.truth, args.spp, args.out)
        return
    from pipeline.usd.check import check

    problems = [p for f in args.files for p in check(f)]
    print("\n".join(problems) if problems else f"{len(args.files)} file(s): no problems")
    sys.exit(1 if problems else 0)


def main() -> None:
    """Entry point; a user's mistake becomes a plain message."""
    run_stage(_run)


if __name__ == "__main__":
    main()
