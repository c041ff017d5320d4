"""Which solids of a field are the object: the large ones, and the small ones that masks ask for.

Where masks overlap by chance a hull holds phantoms, pieces before or behind the object that no mask
denies. What a phantom covers the object covers too. A part that stands apart, a lamp on its chain
or a coin beside a vase, is alone on its pixels in many photos.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy import ndimage
from skimage.measure import marching_cubes

from pipeline.geometry.mesh_io import Mesh, vertex_normals
from pipeline.geometry.voxels import Grid

LARGE = 0.05  # of the largest solid's volume: from here on a solid is kept unasked
# a solid that is asked about has as much of it, a seventh of its width (made masks hold chips of
# ground too, of .0005 on brass_head), and as many cells: fewer have no shape
SMALL, FEWEST = 0.003, 27
ALONE = 1 / 3  # of a solid's pixels, on which it has to be alone

# pixels of every view's mask that a mesh covers, bool (h, w) each
Covered = Callable[[Mesh], list[np.ndarray]]


def contour(field: np.ndarray, grid: Grid) -> Mesh:
    """The zero surface by marching cubes, closed, for beside the grid all is outside. Something has
    to be inside.
    """
    field = np.pad(field, 1, constant_values=-1.0).astype(np.float32)
    vertices, faces, _, _ = marching_cubes(field, 0.0, gradient_direction="ascent")
    vertices = grid.low + (vertices - 1 + 0.5) * grid.cell
    return Mesh(vertices, faces.astype(np.int64), vertex_normals(vertices, faces))


def whole_solids(field: np.ndarray, grid: Grid, covered: Covered | None = None) -> np.ndarray:
    """The field without the solids that are not the object's, and without cavities, which no view
    can see. Small solids are all left out where nothing is known of masks (`covered`).
    """
    labels, count = ndimage.label(field > 0)
    if not count:
        return np.minimum(field, -1e-3)
    cells = np.bincount(labels.ravel())[1:]
    kept = of_the_object(cells, lambda kept: contour(only(field, labels, kept), grid), covered)
    return without_cavities(only(field, labels, kept))


def only(field: np.ndarray, labels: np.ndarray, kept: np.ndarray) -> np.ndarray:
    """The field without solids that are not `kept`, bool by number - 1; number 0 is what is
    empty.
    """
    return np.where(np.concatenate([[True], kept])[labels], field, -0.5)


def of_the_object(
    cells: np.ndarray, mesh_of: Callable[[np.ndarray], Mesh], covered: Covered | None
) -> np.ndarray:
    """Which parts are the object's, bool (n,): the large ones, and those of the small that cover
    enough of the masks where neither the large do, nor those of the small that were taken before.

    cells: volume of every part (n,), in cells of the grid; mesh_of: the surface of parts, bool
    (n,).
    """
    kept = cells >= LARGE * cells.max()
    least = max(FEWEST, SMALL * cells.max())
    small = [k for k in np.argsort(-cells) if cells[k] >= least and not kept[k]]
    if not covered or not small:
        return kept
    others = covered(mesh_of(kept))
    for number in small:
        own = covered(mesh_of(np.arange(len(cells)) == number))
        new = sum(int((a & ~b).sum()) for a, b in zip(own, others))
        if new > ALONE * sum(int(a.sum()) for a in own):
            kept[number] = True
            others = [a | b for a, b in zip(own, others)]
    return kept


def without_cavities(field: np.ndarray) -> np.ndarray:
    """The field with everything filled that is empty and not joined to the grid's border."""
    empty, _ = ndimage.label(field <= 0)
    ends = [0, -1]
    border = [empty[ends].ravel(), empty[:, ends].ravel(), empty[:, :, ends].ravel()]
    outside = np.unique(np.concatenate(border))
    return np.where((empty > 0) & ~np.isin(empty, outside), 0.5, field)
