"""Which observed pixels the transport operator explains: points spread over the surface, each seen
in several photos.

A row is a mean over a few pixels around the point, all of one view. They are coherent: near in
space and alike in normal, so that none lies on another sheet of the surface or beyond an edge. What
is left of curvature inside the patch is the operator's to average (transport.py); to be able to, it
sends its rays through the very pixels that the mean is over.
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

PATCH, LARGEST_PATCH = 2.0, 6.0  # least and most radius in pixels over which photos are averaged
SPACING_SAMPLE = 500  # pixels whose neighbours are counted
STEEP = 0.3  # pixels with a smaller cosine of incidence are left out: each covers much surface
FEWEST_PIXELS = 50
CONE = 15.0  # degrees: normals of a patch lie as near to its point's
PIXELS = 8  # of a patch at most: those nearest to its point
CANDIDATES = 4  # pixels drawn per point, of which the most even spread is kept


@dataclass
class Rows:
    """The operator's n rows: p surface points, each in several views, sorted by point.

    observation (n,): index of the row's central pixel among the observations. point (n,): index of
    its surface point. patch (n, observations): rows of sum 1 that average over up to PIXELS
    coherent pixels around the central one and itself, all of the same view; without it a row is its
    central pixel alone.
    """

    observation: np.ndarray
    point: np.ndarray
    patch: sparse.csr_matrix | None = None

    @property
    def starts(self) -> np.ndarray:
        """First row of each point (p,), for np.add.reduceat."""
        return np.flatnonzero(np.diff(self.point, prepend=-1))

    def rays(self, count: int, rng: np.random.Generator) -> np.ndarray:
        """The observation that each of `count` rays of every row goes through (n, count): the
        pixels of its patch in turn, in random order.
        """
        if self.patch is None:
            return np.repeat(self.observation[:, None], count, 1)

        sizes = np.diff(self.patch.indptr)[:, None]
        # a patch of three has its pixels 0 1 2 0 1 2 0 1, and their order differs from row to row
        turn = np.arange(count) + rng.integers(0, sizes)
        rays = self.patch.indices[self.patch.indptr[:-1, None] + turn % sizes]
        return rng.permuted(rays, axis=1)


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


@dataclass
class SeenPixels:
    """Pixels that see the surface at a usable angle: observation (k,), its index; position (k, 3),
    where its ray meets the surface; normal (k, 3), the shading normal there; width: a pixel's usual
    width on the surface.
    """

    observation: np.ndarray
    position: np.ndarray
    normal: np.ndarray
    width: float

    def patch_radius(self, observations: Observations, rng: np.random.Generator) -> float:
        """Radius in pixels of a disc that holds PIXELS of these, as thinly as they were drawn from
        the photos: the median over a sample, between PATCH and LARGEST_PATCH.
        """
        # views far apart on one plane: no pixel has a neighbour of another view
        apart = observations.view[self.observation] * 10 * np.ptp(observations.pixel)
        place = observations.pixel[self.observation] + apart[:, None]
        sample = place[rng.choice(len(place), min(SPACING_SAMPLE, len(place)), replace=False)]
        count = min(PIXELS, len(place))
        reach = np.median(cKDTree(place).query(sample, count)[0][:, -1])
        return float(np.clip(reach, PATCH, LARGEST_PATCH))

    def around(self, centre: int, near: np.ndarray) -> np.ndarray:
        """Those of `near` (j,) whose normals lie within CONE of pixel `centre`'s, nearest first."""
        coherent = self.normal[near] @ self.normal[centre] > np.cos(np.radians(CONE))
        near = near[coherent]
        distance = np.linalg.norm(self.position[near] - self.position[centre], axis=1)
        return near[np.argsort(distance, kind="stable")]


def usable_pixels(
    observations: Observations, scene: Any, pool: int, rng: np.random.Generator
) -> SeenPixels:
    """Observations that see the surface at a usable angle, at most `pool` of them at random.

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
    normal = np.array(si.sh_frame.n).T[hit]
    focal_length = observations.lens[observations.view[usable], 0]
    return SeenPixels(usable, position, normal, float(np.median(distance / focal_length)))


def one_patch_per_view(
    near: np.ndarray, view: np.ndarray, views: int, rng: np.random.Generator
) -> tuple[np.ndarray, list[np.ndarray]]:
    """Up to `views` of the views that see a point: in each the nearest pixel, and PIXELS of the
    nearest.

    near (k,): observations around the point, nearest first; view (k,): the view of each.
    """
    nearest = np.unique(view, return_index=True)[1]
    kept = rng.permutation(nearest)[:views]
    return near[kept], [near[view == view[k]][:PIXELS] for k in kept]


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
    seen = usable_pixels(observations, scene, pool, rng)
    position = seen.position

    candidates = rng.choice(len(position), min(CANDIDATES * points, len(position)), replace=False)
    centres = candidates[spread_out(position[candidates], points, rng)]

    central = []
    point = []
    patches = []
    radius = seen.patch_radius(observations, rng) * seen.width
    around = cKDTree(position).query_ball_point(position[centres], radius)
    for number, (centre, near) in enumerate(zip(centres, around)):
        coherent = seen.observation[seen.around(centre, np.array(near))]

        pixels, members = one_patch_per_view(coherent, observations.view[coherent], views, rng)
        central.append(pixels)
        point.append(np.full(len(pixels), number))
        patches += members

    patch = averaging_matrix(patches, len(observations))
    return Rows(np.concatenate(central), np.concatenate(point), patch)
