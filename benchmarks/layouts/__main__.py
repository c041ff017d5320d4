"""Turn one scene of a public data set, in its own layout, into a scene folder with truth/.

python -m benchmarks.layouts --layout tensoir --from FOLDER --out SCENE [--lights MAPS]

The ordinary chain runs on SCENE (`photos: SCENE`), and `heliograph score ASSET --truth SCENE`
scores what comes out. What the set does not have is left out, and said so in
SCENE/truth/layout.json and by `heliograph score`. FOLDER is

  nerf_synthetic     of one object: transforms_train.json, transforms_test.json
  tensoir            of one object: train_000/, test_000/ (TensoIR-synthetic, NeRFactor)
  stanford_orb       blender_LDR/<object>_scene00x or blender_HDR/<object>_scene00x
  open_illumination  of one object: Lights/, output/

docs/study.md says which published score is which of ours. Nothing is downloaded.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable
from pathlib import Path

from benchmarks.layouts import nerf_synthetic, open_illumination, stanford_orb, tensoir
from benchmarks.layouts.content import LIGHT_ROWS, Content, Options
from benchmarks.layouts.write import write_scene
from pipeline.base.errors import InputError, nearest, run_stage

LAYOUTS: dict[str, Callable[[Path, Options], Content]] = {
    "nerf_synthetic": nerf_synthetic.read,
    "tensoir": tensoir.read,
    "stanford_orb": stanford_orb.read,
    "open_illumination": open_illumination.read,
}


def convert(layout: str, folder: Path, out: Path, options: Options) -> dict:
    """Write the scene folder `out`; returns what truth/layout.json says. Raises InputError for an
    unknown layout, and for a folder that is not in it.
    """
    if layout not in LAYOUTS:
        raise InputError(f"there is no layout '{layout}'", "--layout", nearest(layout, LAYOUTS))
    if not folder.is_dir():
        raise InputError("there is no such folder", folder, "correct --from")
    whole = Path(os.path.abspath(folder))  # some sets have more beside the folder
    return write_scene(layout, LAYOUTS[layout](whole, options), out, options.side)


def parser() -> argparse.ArgumentParser:
    out = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    out.add_argument("--layout", required=True, help=", ".join(LAYOUTS))
    out.add_argument("--from", dest="folder", type=Path, required=True)
    out.add_argument("--out", type=Path, required=True)
    out.add_argument("--lights", type=Path, help="folder of <name>.hdr or <name>.exr, lat-long")
    out.add_argument("--light", help="the light of the photos, where the set has several")
    out.add_argument("--relights", help="names of other lights, with commas; all if not given")
    out.add_argument("--held-out", choices=("test", "val"), default="test")
    out.add_argument("--train", type=int, help="photos at most, evenly spaced")
    out.add_argument("--test", type=int, help="held-out views at most, and of another scene")
    out.add_argument("--side", type=int, help="longest side in pixels, scaled down to")
    out.add_argument("--light-rows", type=int, default=LIGHT_ROWS, help="rows of maps at most")
    return out


def main() -> None:
    args = parser().parse_args()
    for name, value, least in (("--side", args.side, 8), ("--light-rows", args.light_rows, 2)):
        if value is not None and value < least:
            raise InputError(f"{value} is too small", name, f"give {least} or more")
    options = Options(
        lights=args.lights,
        light=args.light,
        relights=tuple(args.relights.split(",")) if args.relights else None,
        held_out=args.held_out,
        train=args.train,
        test=args.test,
        side=args.side,
        light_rows=args.light_rows,
    )
    convert(args.layout, args.folder, args.out, options)


if __name__ == "__main__":
    run_stage(main)
