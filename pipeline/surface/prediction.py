"""Which of two surfaces of an object the photos speak for: the one through which they predict
photos that were left out.

Every triangle takes the mean of the pixels that show it in most of the photos, and that is compared
with the pixels that show it in the others: cross-validation (Stone 1974). Where a surface lies
wrong, a triangle has the pixels of different points, and predicts worse. Whether depth maps agree
does not tell: on dark gloss without texture they agree on noise.

On metal without texture they agree on what it mirrors, which lies behind the surface and predicts
photos better than the surface does. There the outline tells: what is caved in does not fill it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pipeline.geometry.cameras import View
from pipeline.geometry.mesh_io import Mesh
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
    total = sum(float(mask.sum()) for mask in masks)
    factor = min(1.0, (PIXELS / max(total, 1)) ** 0.5)
    pictures = [reduced(image, factor) for image in images]
    inside = [mask_like(mask, picture) for mask, picture in zip(masks, pictures)]
    sized = [at_size(view, picture) for view, picture in zip(views, pictures)]

    shown = [_shown(mesh, sized) for mesh in (simple, rich)]
    filled = [(a >= 0) & mask for a, mask in zip(shown[0], inside)]
    judged = [both & (b >= 0) for both, b in zip(filled, shown[1])]
    values = [picture[pixels] for picture, pixels in zip(pictures, judged)]
    errors = np.stack(
        [
            _errors([faces[pixels] for faces, pixels in zip(of_mesh, judged)], values)
            for of_mesh in shown
        ]
    )
    better = errors[0] - errors[1]
    whole = max(float(errors[0].sum()), LEAST * sum(map(len, values)), LEAST)
    spread = float(np.sqrt(len(better)) * better.std(ddof=1))
    empty = 1 - sum(both.sum() for both in judged) / max(sum(a.sum() for a in filled), 1)
    return Gain(float(better.sum()) / whole, spread / whole, len(better), float(empty))


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


def _errors(shown: list[np.ndarray], values: list[np.ndarray]) -> np.ndarray:
    """Sum of squared errors of every photo (k,), whose pixels show the triangles `shown` and have
    `values`, (n,) each. A triangle that the other photos do not show has the mean of their pixels.
    """
    count = 1 + max(int(faces.max(initial=0)) for faces in shown)
    fold = np.arange(len(shown)) % FOLDS
    out = np.empty(len(shown))
    for left_out in range(min(FOLDS, len(shown))):
        kept = np.flatnonzero(fold != left_out)
        faces = np.concatenate([shown[k] for k in kept])
        pixels = np.concatenate([values[k] for k in kept])
        weight = np.bincount(faces, minlength=count)
        mean = np.bincount(faces, pixels, count) / np.maximum(weight, 1)
        mean[weight == 0] = pixels.mean() if len(pixels) else 0.0
        for k in np.flatnonzero(fold == left_out):
            out[k] = float(((mean[shown[k]] - values[k]) ** 2).sum())
    return out
