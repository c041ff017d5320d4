"""What methods make of a scene: its light, a held-out view, and that view under other lights.

python -m benchmarks.study.pictures --out STUDY --suite S --scene s_blob__studio_5 \\
    --methods preset_draft,dpi_paper --to docs/study_s_blob.jpg

STUDY is the folder of benchmarks.study. A row for the truth, then one for each method's first draw;
numbers are PSNR in dB of the picture above them (of the light: as log radiance).
"""

from __future__ import annotations

import argparse
from pathlib import Path

import matplotlib
import numpy as np

matplotlib.use("Agg")

from matplotlib import pyplot

from benchmarks.study.charts import STYLE
from benchmarks.study.methods import methods_named
from benchmarks.study.store import ROWS, row_file, suite_folder
from benchmarks.study.together import truth_of_row
from pipeline.base.errors import run_stage
from pipeline.base.files import atomic_path, read_json
from pipeline.base.images import linear_to_srgb
from pipeline.render.envmap import resample_area
from pipeline.render.light_metrics import tone_mapped
from pipeline.report.score import LIGHT_ROWS, true_pictures
from pipeline.report.truth import Truth

VIEW = 0  # the held-out view that is shown
QUALITY = 85  # of the JPEG
CELL = 1.45  # inches of a picture's side
Row = tuple[str, list[tuple[np.ndarray, str]]]  # its name, and pictures (h, w, 3) with their text


def shown_names(truth: Truth) -> list[str]:
    """The pictures of the view, in the scene's light and in others."""
    view = truth.views[VIEW].view.name
    return [name for name in true_pictures(truth) if name.endswith(f"/{view}")]


def inside(pixels: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """As sRGB on white."""
    return linear_to_srgb(np.where(mask[..., None], np.maximum(pixels, 0), 1))


def true_row(truth: Truth) -> Row:
    pictures = true_pictures(truth)
    cells = [(tone_mapped(resample_area(truth.known_light(), LIGHT_ROWS, 2 * LIGHT_ROWS)), "")]
    for name in shown_names(truth):
        known, shown, _ = pictures[name]
        kind, *rest = name.split("/")
        cells.append((inside(shown.mean, known.mask), rest[0] if kind == "relight" else "its own"))
    return "truth", cells


def row_of(row: Path, pack: Path, truth: Truth) -> Row:
    """A method's first draw, from what benchmarks.study.rows writes."""
    scores = read_json(row)
    kept = np.load(pack)
    light = tone_mapped(np.exp(kept["log_light"]))
    cells = [(light, f"{scores['scores']['light_psnr_log']:.1f} dB")]
    for name in shown_names(truth):
        pixels = kept[f"picture/{name}"].astype(np.float32).mean(0)
        cells.append((inside(pixels, truth.views[VIEW].mask), f"{scores['views'][name]:.1f} dB"))
    return scores["method"], cells


def draw(rows: list[Row], to: Path) -> None:
    """`to`, a JPEG."""
    columns = len(rows[0][1])
    wide = [2.0] + [1.0] * (columns - 1)
    with matplotlib.rc_context(STYLE):
        size = (CELL * sum(wide) + 0.3, 1.16 * CELL * len(rows))
        figure, axes = pyplot.subplots(
            len(rows), columns, figsize=size, width_ratios=wide, layout="constrained"
        )
        for line, (name, cells) in zip(axes, rows):
            for place, (picture, text) in zip(line, cells):
                place.imshow(np.clip(picture, 0, 1))
                place.set(xticks=[], yticks=[])
                place.spines[:].set_visible(False)
                place.set_xlabel(text, fontsize=7, labelpad=2)
            line[0].set_ylabel(name, fontsize=7)
        with atomic_path(to) as path:
            figure.savefig(path, dpi=100, pil_kwargs={"quality": QUALITY})
        pyplot.close(figure)


def of_a_scene(text: str | None) -> argparse.ArgumentParser:
    """The command line of pictures of one scene, whose help is `text`."""
    parser = argparse.ArgumentParser(
        description=text, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--rows", type=Path, default=ROWS, help="the committed ones if not given")
    parser.add_argument("--suite", default="XS")
    parser.add_argument("--scene", required=True)
    parser.add_argument("--to", type=Path, required=True)
    return parser


def main() -> None:
    parser = of_a_scene(__doc__)
    parser.add_argument("--methods", required=True, help="names, with commas between")
    args = parser.parse_args()
    folder, draws = suite_folder(args.rows, args.suite), args.out / "draws" / args.scene
    methods = methods_named(args.methods.split(","))
    files = [row_file(folder, args.scene, method, 0) for method in methods]
    truth = truth_of_row(args.out / "scenes" / args.scene, read_json(files[0]))
    rows = [row_of(file, draws / method / "0.npz", truth) for file, method in zip(files, methods)]
    draw([true_row(truth), *rows], args.to)


if __name__ == "__main__":
    run_stage(main)
