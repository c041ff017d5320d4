"""What a viewer shows of finished assets: held-out photos against renders by the shading model of
UsdPreviewSurface, in place of the renderer's own.

python -m benchmarks.viewer --work work/brass_head work/banana [--out rows.json]

A row: `scene`, and of every refined sample, and of their `mean`, with which an asset opens:
`renderer`, its dB by the renderer's model; `exported`, those of UsdPreviewSurface
(benchmarks/preview_bsdf.py) with the numbers that an asset carries
(pipeline/usd/preview_surface.py); `unchanged`, with the renderer's numbers as they are, which
assets carried before; `clipped`, the share of base colours that no UsdPreviewSurface is bright
enough for. All in the pixels that the first sample's stage scored. Viewers differ: this is the
specification's, path traced.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from types import SimpleNamespace

from benchmarks.preview_bsdf import shown_as_preview
from benchmarks.unlit import lit_samples, rows_of_scenes
from pipeline.base.config import Refine, Render
from pipeline.base.errors import run_stage
from pipeline.base.files import read_json
from pipeline.posterior.choose.chosen import Chosen
from pipeline.render.metrics import held_out_photos, score_held_out
from pipeline.render.observe import Observations
from pipeline.render.renderer import Explanation, Renderer
from pipeline.render.samples import FEWEST, Samples, mean_of
from pipeline.usd.preview_surface import for_preview_surface


def row(work: Path, erode: float) -> dict:
    folders = lit_samples(work)
    samples = Samples(folders)
    pixels = read_json(folders[0] / "refine.json")["held_out_pixels"]
    figures = partial(compared, work, erode=erode, pixels=pixels)
    found = {"scene": work.name, "samples": [figures(x) for x in samples]}
    mean = mean_of(samples, samples.weights) if len(samples) >= FEWEST else None
    return found | ({} if mean is None else {"mean": figures(mean, decide=True)})


def compared(work: Path, x: Explanation, erode: float, pixels: int, decide: bool = False) -> dict:
    """Figures of one explanation, from so many pixels of all held-out photos together."""
    shown, clipped = for_preview_surface(x, decide)
    score = lambda y: scored(work, y, erode, pixels)
    found = {"renderer": score(x)}
    with shown_as_preview():
        found |= {"exported": score(shown), "unchanged": score(x)}
    return found | {"clipped": clipped}


def scored(work: Path, x: Explanation, erode: float, pixels: int) -> float:
    """Held-out dB of an explanation under the scene's cameras."""
    chosen = Chosen.load(work / "choose").settings.get("render", {})
    depth = chosen.get("max_depth", Render().max_depth)
    renderer = Renderer(work / "atlas" / "mesh_uv.ply", len(x.base_color), len(x.light), depth)
    observations = Observations(work / "observe", work / "poses" / "cameras.json")
    seen = SimpleNamespace(observations=observations, renderer=renderer)
    held_out = held_out_photos(seen, work / "poses", work / "mesh", erode)
    return score_held_out(seen, x, held_out, pixels, Refine().score_spp)["held_out_psnr"]


def main() -> None:
    rows_of_scenes(__doc__, row)


if __name__ == "__main__":
    run_stage(main)
