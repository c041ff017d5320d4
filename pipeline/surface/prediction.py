"""Which of two surfaces of an object the photos speak for: the one through which they predict
photos that were left out.

Every triangle takes the mean of the pixels that show it in most of the photos, and that is compared
with the pixels that show it in the others: cross-validation (Stone 1974). Where a surface lies
wrong, a triangle has the pixels of different points, and predicts worse. Whether depth maps agree
does not tell: on dark gloss without texture they agree on noise.

On metal without texture they agree on what it mirrors, which lies behind the surface and predicts
photos better than the surface does. There the outline tells: what is caved in does not fill it.

`gain` asks of whole surfaces, `gain_around` of the surroundings of every point.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from pipeline.geometry.cameras import View
from pipeline.geometry.mesh_io import Mesh
from pipeline.geometry.voxels import Grid
from pipeline.surface.pictures import at_size, mask_like, reduced
from pipeline.surface.zbuffer import Crop, z_buffer

FOLDS = 5  # of the photos, each of which is predicted from the others
PIXELS = 1.5e6  # of all masks together, at most, that are looked at
CLEAR = 2.0  # standard errors by which the richer surface has to predict better
# Share of the error that it has to save at least, by whether the masks were given. Depth maps have
# seen the photos that judge, and save 10 % where they are noise (a boombox of dark gloss), 24 and
# 47 % where they are not (a corset, a toy of bricks). The hull of masks that were made has the
# errors of those masks as well, and is the worse surface at less: a brass head's depth saves 5
# to 8 % of the error, and its asset predicts held-out photos better by a decibel.
WORTH = {True: 0.15, False: 0.04}
# share of the outline that the rich surface may leave empty. Depth of what mirrors lies behind the
# surface and carves it: 22 % are left empty on a figure of brushed metal, 16 % on a glossy head
# whose masks were made. Of masks that were made depth tells what ground they hold, 6 % on a corset
# that stands in its shadow. 1 % on the corset and the toy of bricks whose masks were given
EMPTY = 0.1
LEAST = (1 / 255) ** 2 / 12  # squared error that rounding to eight bits leaves a pixel
BLOCK = 3  # cells along the side of a block, over which errors are summed for `gain_around`
AROUND = 1.5  # blocks: standard deviation of the surroundings of a point


@dataclass(frozen=True)
class Gain:
    """By what share of the simple surface's squared error the rich one predicts better, the
    standard error of that share over photos, how many there are, and what share of the masks'
    pixels that show the simple surface the rich one leaves empty.
    """

    share: float
    standard_error: float
    photos: int
    empty: float

    def clear(self, given: bool) -> bool:
        """Whether it is more than chance, and than what having seen all photos saves.

        given: the masks are the user's own.
        """
        return self.share > max(WORTH[given], CLEAR * self.standard_error)

    @property
    def fills(self) -> bool:
        """Whether the rich surface fills the outline, as far as may be asked of it."""
        return self.empty <= EMPTY


def gain(
    simple: Mesh,
    rich: Mesh,
    views: list[View],
    images: list[np.ndarray],
    masks: list[np.ndarray],
) -> Gain:
    """Of the pixels of the masks: errors of those that show both surfaces.

    images: (h, w) float per view, grey in display units; masks: (h, w) bool, of the same sizes.
    """
    seen = Compared.of((simple, rich), views, images, masks)
    errors = np.array([[photo.sum() for photo in of_mesh] for of_mesh in seen.errors()])
    better = errors[0] - errors[1]
    pixels = sum(map(len, seen.values))
    whole = max(float(errors[0].sum()), LEAST * pixels, LEAST)
    spread = float(np.sqrt(len(better)) * better.std(ddof=1))
    empty = 1 - pixels / max(seen.filled, 1)
    return Gain(float(better.sum()) / whole, spread / whole, len(better), float(empty))


def gain_around(
    simple: Mesh,
    rich: Mesh,
    views: list[View],
    images: list[np.ndarray],
    masks: list[np.ndarray],
    grid: Grid,
) -> Callable[[np.ndarray], np.ndarray]:
    """As `gain`, but of the surroundings of points (n, 3): by what share (n,) of the simple
    surface's error the rich one predicts better there. 1 where no photo sees either.

    A pixel tells of the two places where the two surfaces lie in it.
    """
    seen = Compared.of((simple, rich), views, images, masks)
    errors = [np.concatenate(of_mesh) for of_mesh in seen.errors()]
    shape = [-(-side // BLOCK) for side in grid.shape]
    side = BLOCK * grid.cell
    sums = np.zeros((2, int(np.prod(shape))))
    for mesh, faces in zip((simple, rich), seen.faces):
        place = mesh.vertices[mesh.faces].mean(1)[np.concatenate(faces)]
        block = np.clip((place - grid.low) // side, 0, np.array(shape) - 1).astype(int)
        number = np.ravel_multi_index(tuple(block.T), shape)
        sums += [np.bincount(number, error, sums.shape[1]) for error in errors]
    by_simple, by_rich = (ndimage.gaussian_filter(a.reshape(shape), AROUND) for a in sums)

    def share(points: np.ndarray) -> np.ndarray:
        at = ((points - grid.low) / side - 0.5).T
        sampled = lambda a: ndimage.map_coordinates(a, at, order=1, mode="nearest")
        return 1 - sampled(by_rich) / np.maximum(sampled(by_simple), LEAST)

    return share


@dataclass
class Compared:
    """Pixels of the photos that show all of some surfaces within the masks. faces: of each surface,
    and each photo, the triangles (k,) that its pixels show; values: of each photo its pixels (k,);
    filled: how many pixels of the masks show the first surface.
    """

    faces: list[list[np.ndarray]]
    values: list[np.ndarray]
    filled: int

    @classmethod
    def of(
        cls,
        meshes: tuple[Mesh, ...],
        views: list[View],
        images: list[np.ndarray],
        masks: list[np.ndarray],
    ) -> Compared:
        """As `gain` takes them, of at most PIXELS of the masks."""
        total = sum(float(mask.sum()) for mask in masks)
        factor = min(1.0, (PIXELS / max(total, 1)) ** 0.5)
        pictures = [reduced(image, factor) for image in images]
        inside = [mask_like(mask, picture) for mask, picture in zip(masks, pictures)]
        sized = [at_size(view, picture) for view, picture in zip(views, pictures)]

        shown = [_shown(mesh, sized) for mesh in meshes]
        filled = [(first >= 0) & mask for first, mask in zip(shown[0], inside)]
        judged = [
            mask & np.all([faces >= 0 for faces in at], 0) for mask, at in zip(filled, zip(*shown))
        ]
        of_judged = lambda arrays: [array[pixels] for array, pixels in zip(arrays, judged)]
        faces = [of_judged(of_mesh) for of_mesh in shown]
        return cls(faces, of_judged(pictures), int(sum(mask.sum() for mask in filled)))

    def errors(self) -> list[list[np.ndarray]]:
        """Squared errors (k,) of each photo's pixels, predicted from other photos, by surface."""
        return [_errors(faces, self.values) for faces in self.faces]


def _shown(mesh: Mesh, views: list[View]) -> list[np.ndarray]:
    """For every view the triangle that each pixel (h, w) shows, -1 for none."""
    vertices, faces = mesh.vertices.astype(float), np.ascontiguousarray(mesh.faces)
    out = []
    for view in views:
        crop = Crop.around(view, vertices, 0)
        whole = np.full((view.height, view.width), -1, np.int64)
        crop.of(whole)[...] = z_buffer(crop, vertices, faces)[1]
        out.append(whole)
    return out


def _errors(shown: list[np.ndarray], values: list[np.ndarray]) -> list[np.ndarray]:
    """Squared errors (n,) of every photo, whose pixels show the triangles `shown` and have
    `values`, (n,) each. A triangle that the other photos do not show has the mean of their pixels.
    """
    count = 1 + max(int(faces.max(initial=0)) for faces in shown)
    fold = np.arange(len(shown)) % FOLDS
    out = [np.empty(0)] * len(shown)
    for left_out in range(min(FOLDS, len(shown))):
        kept = np.flatnonzero(fold != left_out)
        faces = np.concatenate([shown[k] for k in kept])
        pixels = np.concatenate([values[k] for k in kept])
        weight = np.bincount(faces, minlength=count)
        mean = np.bincount(faces, pixels, count) / np.maximum(weight, 1)
        mean[weight == 0] = pixels.mean() if len(pixels) else 0.0
        for k in np.flatnonzero(fold == left_out):
            out[k] = (mean[shown[k]] - values[k]) ** 2
    return out
