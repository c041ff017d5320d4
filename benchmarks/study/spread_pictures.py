"""What draws of a scene agree on: its light, a held-out view, and that view under other lights.

python -m benchmarks.study.spread_pictures --out STUDY --suite S --scene s_vase__room_4 \\
    --method preset_standard --to docs/study_s_vase_draws.jpg

STUDY is the folder of benchmarks.study. Rows: the truth, every draw, how far draws lie apart
(standard deviation), and how far their mean is off the truth. Pictures are compared as sRGB values,
lights as logs of radiance less their mean. Black to yellow is 0 to FULL; below stands the root mean
square. Where the error is bright, an honest spread is too.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from benchmarks.figures import matplotlib
from benchmarks.study.methods import methods_named
from benchmarks.study.pictures import VIEW, Row, draw, of_a_scene, row_of, shown_names, true_row
from benchmarks.study.store import row_file, seeds_in, suite_folder
from benchmarks.study.together import truth_of_row
from pipeline.base.errors import InputError, run_stage
from pipeline.base.files import read_json
from pipeline.base.images import linear_to_srgb
from pipeline.render.envmap import resample_area
from pipeline.render.samples import FEWEST
from pipeline.report.score import LIGHT_ROWS, centred_log, true_pictures
from pipeline.report.truth import Truth

LIGHT_FULL, PICTURE_FULL = 2.0, 0.2  # at the bright end: log radiance, sRGB
COLORS = matplotlib.colormaps["inferno"]

Compared = list[np.ndarray]  # the light (h, 2h, 3), then the pictures (h, w, 3) of the view


def true_values(truth: Truth) -> Compared:
    known = true_pictures(truth)
    light = centred_log(resample_area(truth.known_light(), LIGHT_ROWS, 2 * LIGHT_ROWS))
    return [light, *(linear_to_srgb(known[name][1].mean) for name in shown_names(truth))]


def drawn_values(pack: Path, truth: Truth) -> Compared:
    kept = np.load(pack)
    of = lambda name: linear_to_srgb(kept[f"picture/{name}"].astype(np.float32).mean(0))
    return [kept["log_light"], *map(of, shown_names(truth))]


def heat(name: str, values: Compared, mask: np.ndarray) -> Row:
    """A row of maps: root mean squares over the channels, nothing outside the mask (h, w)."""
    cells = []
    for k, difference in enumerate(values):
        size = np.sqrt(np.mean(difference**2, -1))
        inside = np.ones(size.shape, bool) if k == 0 else mask
        picture = COLORS(size / (PICTURE_FULL if k else LIGHT_FULL))[..., :3]
        picture[~inside] = 1
        cells.append((picture, f"{np.sqrt(np.mean(size[inside] ** 2)):.2g}"))
    return name, cells


def spread_rows(draws: list[Compared], known: Compared, mask: np.ndarray) -> list[Row]:
    """How far draws lie apart (n - 1), and their mean off what is known."""
    together = [np.stack(values) for values in zip(*draws)]
    apart = heat("spread", [values.std(0, ddof=1) for values in together], mask)
    off = [values.mean(0) - true for values, true in zip(together, known)]
    return [apart, heat("error of the mean", off, mask)]


def main() -> None:
    parser = of_a_scene(__doc__)
    parser.add_argument("--method", required=True)
    args = parser.parse_args()
    methods_named([args.method])
    folder, packs = suite_folder(args.rows, args.suite), args.out / "draws" / args.scene
    seeds = seeds_in(folder / args.scene / args.method)
    if len(seeds) < FEWEST:
        raise InputError("fewer than two draws say nothing of spread", args.scene, "run more")
    files = [row_file(folder, args.scene, args.method, seed) for seed in seeds]
    kept = [packs / args.method / f"{seed}.npz" for seed in seeds]
    truth = truth_of_row(args.out / "scenes" / args.scene, read_json(files[0]))

    rows = [true_row(truth)]
    for seed, (file, pack) in enumerate(zip(files, kept)):
        rows.append((f"draw {seed}", row_of(file, pack, truth)[1]))
    values = [drawn_values(pack, truth) for pack in kept]
    rows += spread_rows(values, true_values(truth), truth.views[VIEW].mask)
    draw(rows, args.to)


if __name__ == "__main__":
    run_stage(main)
