"""A finished scene to look at: held-out photos beside what the asset makes of them.

python -m benchmarks.look --work work/garden --out garden.jpg [--sample 0]

One row per held-out view: the photo, the plain textured mesh (`benchmarks.unlit`), the refined
sample under its light, the shading normals (world frame, (n + 1) / 2), base colour, roughness and
metallic. All but the photo are black beside the mesh.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from benchmarks.normals import NormalCaster, pixel_rays
from benchmarks.unlit import bake, load, picture
from pipeline.base.config import Observe, Render, Report
from pipeline.base.errors import run_stage
from pipeline.base.images import in_rows, to_srgb8, write_png
from pipeline.geometry.cameras import View
from pipeline.posterior.textures import gather
from pipeline.render.metrics import render_pixels
from pipeline.render.observe import Tracer
from pipeline.render.renderer import Explanation, Renderer

VIEWS = 4  # rows at most
MARGIN = 8  # pixels around the object


def normals_seen(view: View, cast: NormalCaster) -> np.ndarray:
    """Shading normals as colours (h, w, 3) uint8."""
    hit, _, normals = cast(*pixel_rays(view))
    out = np.zeros((view.height * view.width, 3), np.uint8)
    out[hit] = np.round((normals + 1) * 127.5)
    return out.reshape(view.height, view.width, 3)


def map_seen(view: View, tracer: Tracer, values: np.ndarray) -> np.ndarray:
    """A map (t, t, c) as the view sees it (h, w, c), zero beside the mesh."""
    uv, _, hit = tracer.hit(*pixel_rays(view))
    out = np.zeros((view.height * view.width, values.shape[2]), np.float32)
    out[hit] = gather(values, uv[hit])
    return out.reshape(view.height, view.width, -1)


def grey(values: np.ndarray) -> np.ndarray:
    """A scalar map (h, w, 1) in [0, 1] as a picture (h, w, 3) uint8."""
    return np.repeat(np.round(255 * values).astype(np.uint8), 3, -1)


def cropped(tiles: list[np.ndarray], mask: np.ndarray) -> list[np.ndarray]:
    """Tiles (h, w, 3) cut to the box around the mask (h, w)."""
    rows, columns = np.nonzero(mask)
    top, left = max(rows.min() - MARGIN, 0), max(columns.min() - MARGIN, 0)
    box = slice(top, rows.max() + MARGIN), slice(left, columns.max() + MARGIN)
    return [tile[box] for tile in tiles]


def rows_of_tiles(work: Path, sample: Path) -> list[list[np.ndarray]]:
    """The tiles of each row, uint8."""
    held_out, tracer, pixels = load(work, Observe().erode)
    x = Explanation.load(sample)
    size = x.roughness.shape[0]
    texture, _ = bake(pixels, size)
    mesh = work / "atlas" / "mesh_uv.ply"
    cast = NormalCaster.of_file(mesh)
    renderer = Renderer(mesh, size, x.light.shape[0], Render().max_depth)

    rows = []
    for view, photo, mask in held_out[:VIEWS]:
        whole = np.ones(mask.shape, bool)
        tiles = [
            to_srgb8(photo),
            to_srgb8(picture(view, whole, texture, tracer)),
            to_srgb8(render_pixels(renderer, x, view, whole, Report().spp)),
            normals_seen(view, cast),
            to_srgb8(map_seen(view, tracer, x.base_color)),
            grey(map_seen(view, tracer, x.roughness[..., None])),
            grey(map_seen(view, tracer, x.metallic[..., None])),
        ]
        rows.append(cropped(tiles, mask))
    return rows


def below_each_other(rows: list[list[np.ndarray]]) -> np.ndarray:
    """Rows of tiles (h, w, 3), each row's of one size, as one picture, filled up with black."""
    sheets = [in_rows(tiles, len(tiles)) for tiles in rows]
    width = max(sheet.shape[1] for sheet in sheets)
    return np.concatenate(
        [np.pad(sheet, ((0, 0), (0, width - sheet.shape[1]), (0, 0))) for sheet in sheets]
    )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--sample", type=int, default=0)
    parser.add_argument("--out", type=Path, required=True, help=".jpg or .png")
    args = parser.parse_args()

    rows = rows_of_tiles(args.work, args.work / "refine" / str(args.sample))
    write_png(args.out, below_each_other(rows))


if __name__ == "__main__":
    run_stage(main)
