"""One page of charts as xatlas lays it out.

Three properties of xatlas are minded: it leaves out triangles below 1.2e-7 in area, in whatever
unit, and lays other charts over them, so it gets coordinates in texels; it dilates every chart by
the padding, so it gets half of it; it shrinks a chart that is wider than a given page, so it gets
no page and says how large its own became.

A fourth has no cure here: where an atlas is destroyed, xatlas wakes its threads and waits for their
end, and a thread that is about to sleep just then misses the call and never ends. `placed` keeps
its atlas, and is to be called by pipeline.base.apart, so that it ends with its process.
"""

from __future__ import annotations

import numpy as np
import xatlas

from pipeline.base.apart import hold

LEFT_OUT = 2**32 - 1  # xatlas's chart of a vertex all of whose triangles it leaves out


def placed(
    scaled: list[np.ndarray], corners: list[np.ndarray], half: int, width: int
) -> tuple[list[np.ndarray], tuple[int, int]]:
    """Charts in texels as xatlas places them on a page that is at least so wide, no two nearer than
    2 half texels, and the page's sides in u and v.

    xatlas lets a page that begins empty grow where many thin charts are longest. So a bar as wide
    as the page, one texel high, is placed before all others, and taken out again.
    """
    bar = np.array([[0, 0], [width - 1, 0], [width - 1, 1], [0, 1]], float)
    shapes = [*scaled, bar]
    triangles = [*corners, np.array([[0, 1, 2], [0, 2, 3]])]
    first = np.cumsum([0] + [len(uv) for uv in shapes])
    faces = np.concatenate([start + corner for start, corner in zip(first, triangles)])
    number = np.repeat(np.arange(len(triangles)), [len(corner) for corner in triangles])
    atlas = xatlas.Atlas()
    hold(atlas)
    atlas.add_uv_mesh(
        np.concatenate(shapes).astype(np.float32),
        faces.astype(np.uint32),
        number[:, None].astype(np.uint32),  # as materials: what keeps charts apart
    )
    options = xatlas.PackOptions()
    options.resolution = 0
    options.texels_per_unit = 1.0
    options.padding = half
    options.bilinear = False
    options.blockAlign = False
    options.bruteForce = True
    options.rotate_charts = False
    options.rotate_charts_to_axis = False
    atlas.generate(xatlas.ChartOptions(), options)

    index, _, uv = atlas.get_mesh(0)
    places = np.full((first[-1], 2), np.nan)
    known = atlas.get_mesh_vertex_assignment(0)[1] != LEFT_OUT
    places[index[known]] = (uv * [atlas.width, atlas.height])[known]
    moved = [_moved(uv, to) for uv, to in zip(scaled, np.split(places, first[1:-1]))]
    under = int(np.nanmin(places[: first[-2], 1], initial=0))
    return [uv - [0, under] for uv in moved], (atlas.width, atlas.height - under)


def _moved(uv: np.ndarray, placed: np.ndarray) -> np.ndarray:
    """A chart's coordinates (k, 2) moved as xatlas moved those of its vertices that it placed (the
    others are NaN): along either axis scaled to whole texels, and shifted. A chart of which it
    placed none covers no texel, wherever it lies.
    """
    known = np.flatnonzero(np.isfinite(placed[:, 0]))
    if not len(known):
        return uv - uv.min(0)
    out = np.empty_like(uv)
    for axis in range(2):
        line = uv[known, axis]
        low, high = known[np.argmin(line)], known[np.argmax(line)]
        stretch = np.ptp(placed[[low, high], axis]) / max(np.ptp(line), 1e-12)
        out[:, axis] = placed[low, axis] + stretch * (uv[:, axis] - uv[low, axis])
    return out
