"""Which observed pixels the transport operator explains: points spread over the surface, each seen
in several photos.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

from pipeline.base.errors import InputError
from pipeline.base.runtime import mitsuba_rays
from pipeline.render.observe import Observations

PATCH = 2.0  # radius in pixels over which photos are averaged
STEEP = 0.3  # pixels with a smaller cosine of incidence are left out: each covers much surface
FEWEST_PIXELS = 50
CANDIDATES = 4  # pixels drawn per point, of which the most even spread is kept


@dataclass
class Rows:
    """The operator's n rows: p surface points, each in several views, sorted by point.

    observation (n,): index of the row's central pixel among the observations. point (n,): index of
    its surface point. patch (n, observations): rows of sum 1 that average over the pixels around
    the central one, all of the same view, for less noise.
    """

    observation: np.ndarray
    point: np.ndarray
    patch: sparse.csr_matrix | None = None

    @property
    def starts(self) -> np.ndarray:
        """First row of each point (p,), for np.add.reduceat."""
        return np.flatnonzero(np.diff(self.point, prepend=-1))


def spread_out(points: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    """Indices of `count` of the points (n, 3) by farthest-point sampling; of all if there are no
    more.
    """
    if len(points) <= count:
        return np.arange(len(points))

    chosen = [int(rng.integers(len(points)))]
    distance = np.linalg.norm(points - points[chosen[0]], axis=1)
    for _ in range(count - 1):
        chosen.append(int(distance.argmax()))
        distance = np.minimum(distance, np.linalg.norm(points - points[chosen[-1]], axis=1))
    return np.array(chosen)


def usable_pixels(
    observations: Observations, scene: Any, pool: int, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, float]:
    """Observations that see the surface at a usable angle, at most `pool` of them at random: their
    indices (k,), where their rays meet the surface (k, 3), and a pixel's usual width there.

    Raises InputError if there are too few.
    """
    usable = np.flatnonzero(observations.cosine > STEEP)
    if len(usable) < FEWEST_PIXELS:
        raise InputError(
            f"fewer than {FEWEST_PIXELS} observed pixels see the surface at a usable angle",
            "observe",
            "photograph the object from more sides, or check the mesh and the masks",
        )
    usable = np.sort(rng.choice(usable, min(pool, len(usable)), replace=False))

    origins, directions = observations.centre_rays(usable)
    si = scene.ray_intersect(mitsuba_rays(origins, directions))
    hit = np.array(si.is_valid()).astype(bool)
    distance = np.array(si.t)[hit]
    usable = usable[hit]

    position = origins[hit] + distance[:, None] * directions[hit]
    focal_length = observations.lens[observations.view[usable], 0]
    return usable, position, np.median(distance / focal_length)


def one_patch_per_view(
    near: np.ndarray, view: np.ndarray, views: int, rng: np.random.Generator
) -> tuple[np.ndarray, list[np.ndarray]]:
    """Up to `views` of the views that see a point: in each the nearest pixel, and all near pixels.

    near (k,): observations around the point, nearest first; view (k,): the view of each.
    """
    nearest = np.unique(view, return_index=True)[1]
    kept = rng.permutation(nearest)[:views]
    return near[kept], [near[view == view[k]] for k in kept]


def averaging_matrix(patches: list[np.ndarray], observations: int) -> sparse.csr_matrix:
    """(patches, observations): the mean over each patch's observations."""
    sizes = np.array([len(patch) for patch in patches])
    row = np.repeat(np.arange(len(sizes)), sizes)
    column = np.concatenate(patches)
    weight = np.repeat(1 / sizes, sizes)
    return sparse.csr_matrix((weight, (row, column)), (len(sizes), observations))


def choose_rows(
    observations: Observations,
    scene: Any,
    points: int,
    views: int,
    seed: int,
    pool: int = 400_000,
) -> Rows:
    """`points` points spread evenly over the seen surface, each with up to `views` patches of
    pixels that show it, one per view.

    scene: Mitsuba scene with the mesh. pool: most observations that are looked at. Raises
    InputError if too few see the surface at a usable angle.
    """
    rng = np.random.default_rng(seed)
    usable, position, pixel_width = usable_pixels(observations, scene, pool, rng)

    candidates = rng.choice(len(usable), min(CANDIDATES * points, len(usable)), replace=False)
    centres = position[candidates[spread_out(position[candidates], points, rng)]]

    central = []
    point = []
    patches = []
    around = cKDTree(position).query_ball_point(centres, PATCH * pixel_width)
    for number, near in enumerate(around):
        near = np.array(near)
        distance = np.linalg.norm(position[near] - centres[number], axis=1)
        near = usable[near[np.argsort(distance, kind="stable")]]

        pixels, members = one_patch_per_view(near, observations.view[near], views, rng)
        central.append(pixels)
        point.append(np.full(len(pixels), number))
        patches += members

    patch = averaging_matrix(patches, len(observations))
    return Rows(np.concatenate(central), np.concatenate(point), patch)
