"""Photometric refinement: vertices move along their normals until the photos agree.

Vu, Labatut, Pons, Keriven, "High Accuracy and Visibility-Consistent Dense Multiview Stereo", PAMI
2012: the energy is 1 - ZNCC of each photo and its neighbours' photos reprojected through the
surface (`pipeline.surface.consistency`), plus the thin-plate energy of the surface. Where the
photos say little, because the surface is plain, glossy or hidden, only the plate acts.

Unlike the paper, which descends along the gradient, each step solves

    (second derivatives of the photos + thin plate) movement = gradient of both

for all vertices at once (Gauss-Newton), which takes some ten steps for its hundreds.

Letters: x vertices; n their normals; g, h first and second derivative of the photos' agreement by a
vertex's movement along its normal; L the umbrella operator: mean of the neighbours minus the
vertex.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numba import njit

from pipeline.base.config import Mesh as MeshSettings
from pipeline.base.progress import Bar
from pipeline.geometry.cameras import View
from pipeline.geometry.mesh_io import Mesh, unit, vertex_normals
from pipeline.surface.consistency import WINDOW, Sight, pull, with_slopes
from pipeline.surface.outlines import edge_of, outline_pull
from pipeline.surface.pictures import affordable, at_size, reduced
from pipeline.surface.plate import Plate, footprint_of
from pipeline.surface.zbuffer import Crop, z_buffer

RIM = 2  # pixels beside an outline of the surface that are not looked at: it may lie elsewhere
ASLANT = 0.2  # smallest cosine between a surface's normal and the view's ray


@dataclass(frozen=True)
class Refinement:
    """Settings of `refine_mesh`.

    steps: at each scale; scales: of the photos, coarse to fine; plate: weight of the thin plate;
    it keeps bumps of about (plate / .05)^(1/4) pixels' footprints across from following noise,
    whatever the scale. crease: bend in pixels' footprints from which on the plate gives way, so
    that edges stay sharp. pixels: of all views together, at most, that one step looks at: where the
    object's photos have more the scales are reduced.
    """

    steps: tuple[int, ...] = (MeshSettings().refine_steps,) * 2
    scales: tuple[float, ...] = (0.5, 1.0)
    plate: float = MeshSettings().plate
    crease: float = 0.5
    pixels: float = 12e6


@dataclass(frozen=True)
class Refined:
    """A surface after refinement.

    known: (n,), how much photos know of where each vertex lies: second derivative of their weighted
    agreement by a movement of one pixel's footprint, per square footprint of surface, all pairs of
    views together. facts: agreement and movement of every step, and seconds.
    """

    mesh: Mesh
    known: np.ndarray
    facts: dict


def refine_mesh(
    mesh: Mesh,
    views: list[View],
    images: list[np.ndarray],
    neighbours: list[list[int]],
    settings: Refinement = Refinement(),
    masks: Sequence[np.ndarray | None] | None = None,
    threads: int = 2,
    watch: Callable[[np.ndarray, dict], None] | None = None,
) -> Refined:
    """The mesh moved to where the photos agree best.

    mesh: triangles about as large as the pixels' footprints, or smaller. images: one (h, w) float
    per view, grey in display units (sRGB-encoded, 0 to 1), any scale of the view's whole picture.
    neighbours: for each view those it is compared with. masks: (h, w) bool per view, of its whole
    picture at any scale, whose edges pull at the surface's outlines (`pipeline.surface.outlines`),
    None for a view whose mask is not to be believed; without them only the photos pull.
    watch: called after each step with the vertices (n, 3) and the step's facts, for measurements.
    Faces and their order are kept.

    Raises ValueError where the lists do not have one entry per view, or a view is its own
    neighbour.
    """
    if not len(views) == len(images) == len(neighbours):
        raise ValueError("views, images and neighbours must have one entry per view")
    if any(k in near for k, near in enumerate(neighbours)):
        raise ValueError("a view cannot be its own neighbour")

    begin = time.monotonic()
    x = mesh.vertices.astype(float)
    faces = np.ascontiguousarray(mesh.faces)
    plate = Plate(len(x), faces, settings.plate, settings.crease)
    shrink = affordable(mesh, views, images, settings.pixels / max(settings.scales) ** 2)
    known = np.zeros(len(x))
    history = []
    with Bar("refine surface", sum(settings.steps)) as bar, ThreadPoolExecutor(threads) as pool:
        for scale, steps in zip(settings.scales, settings.steps):
            pictures = [reduced(image, scale * shrink) for image in images]
            sized = [at_size(v, p) for v, p in zip(views, pictures)]
            edges = [edge_of(m, p.shape) for m, p in zip(masks or [None] * len(views), pictures)]
            home = x
            for _ in range(steps):
                g, h, score = _photo_pull(x, faces, sized, pictures, neighbours, pool)
                footprint = footprint_of(x, sized)
                known = h * footprint**4 / np.maximum(plate.area(x), 1e-12 * footprint**2)
                g, h = np.array([g, h]) + outline_pull(x, faces, sized, edges, pool)
                x, moved = plate.step(x, home, g, h, footprint)
                done = {"scale": scale * shrink, "score": score, "moved_pixels": moved}
                history.append(done)
                bar.step(f"agreement {score:.3f}")
                if watch is not None:
                    watch(x, done)
    refined = Mesh(x, mesh.faces, vertex_normals(x, mesh.faces), mesh.uv)
    facts = {"steps": history, "seconds": round(time.monotonic() - begin, 2)}
    return Refined(refined, known, facts)


def _face_normals(x: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Unit normals (m, 3)."""
    a, b, c = (x[faces[:, corner]] for corner in range(3))
    return unit(np.cross(b - a, c - a))


def _photo_pull(
    x: np.ndarray,
    faces: np.ndarray,
    views: list[View],
    pictures: list[np.ndarray],
    neighbours: list[list[int]],
    pool: ThreadPoolExecutor,
) -> tuple[np.ndarray, np.ndarray, float]:
    """g and h (n,) of all views, and the mean score of all pixels that two views see."""
    flat = _face_normals(x, faces)
    normals = vertex_normals(x, faces)

    def look(k: int) -> tuple[Sight, np.ndarray]:
        crop = Crop.around(views[k], x, WINDOW)
        depth, seen = z_buffer(crop, x, faces)
        front = _front(depth, seen, flat, _rays(crop), 1 / views[k].fx)
        photo = with_slopes(crop.of(pictures[k]))
        return Sight(crop, photo, depth, front, 1 / views[k].fx), seen

    sights = list(pool.map(look, range(len(views))))

    def compare(k: int) -> tuple[np.ndarray, float, float]:
        i, seen = sights[k]
        first = np.zeros(i.depth.shape, np.float32)
        second = np.zeros(i.depth.shape, np.float32)
        total = 0.0
        count = 0.0
        for j in neighbours[k]:
            by_depth, twice, score = pull(i, sights[j][0])
            first += by_depth
            second += twice
            known = np.isfinite(score)
            total += float(score[known].sum())
            count += float(known.sum())
        eye = -i.crop.rotation.T @ i.crop.shift
        at = _gather(first, second, i.depth, seen, x, faces, flat, normals, _rays(i.crop), eye)
        return at, total, count

    both = np.zeros((2, len(x)))
    total = 0.0
    count = 0.0
    for at, score, pixels in pool.map(compare, range(len(views))):
        both += at
        total += score
        count += pixels
    return both[0], both[1], total / max(count, 1)


def _rays(crop: Crop) -> np.ndarray:
    """(3, 3) from a pixel's (column, row, 1) to its ray in the world at unit depth."""
    return crop.rotation.T @ np.linalg.inv(crop.intrinsics)


@njit(nogil=True, fastmath=True, cache=True)
def _front(
    depth: np.ndarray, seen: np.ndarray, flat: np.ndarray, rays: np.ndarray, footprint: float
) -> np.ndarray:
    """Pixels (h, w) that see the outside of the surface, not too much aslant and not beside an
    outline: where the depth jumps by more than a slanted surface's would.
    """
    h, w = depth.shape
    out = np.zeros((h, w), np.bool_)
    for row in range(RIM, h - RIM):
        for column in range(RIM, w - RIM):
            if seen[row, column] < 0:
                continue
            d = rays[:, 0] * (column + 0.5) + rays[:, 1] * (row + 0.5) + rays[:, 2]
            n = flat[seen[row, column]]
            cosine = -(n[0] * d[0] + n[1] * d[1] + n[2] * d[2])
            length = np.sqrt(d[0] ** 2 + d[1] ** 2 + d[2] ** 2)
            if cosine <= ASLANT * length:
                continue

            z = depth[row, column]
            jump = 2 * RIM * footprint * z / ASLANT
            even = True
            for down in (-RIM, 0, RIM):
                for across in (-RIM, 0, RIM):
                    even &= abs(depth[row + down, column + across] - z) < jump
            out[row, column] = even
    return out


@njit(nogil=True, fastmath=True, cache=True)
def _gather(
    first: np.ndarray,
    second: np.ndarray,
    depth: np.ndarray,
    seen: np.ndarray,
    x: np.ndarray,
    faces: np.ndarray,
    flat: np.ndarray,
    normals: np.ndarray,
    rays: np.ndarray,
    eye: np.ndarray,
) -> np.ndarray:
    """g and h (2, n) from the derivatives by depth of each pixel (h, w).

    A triangle with normal N whose corners move by m_k along n_k moves its point with barycentric
    coordinates w_k along the ray d by sum_k w_k m_k (N . n_k) / (N . d). Second derivatives are
    lumped on the diagonal: exact where neighbours move alike, and too large, never too small, where
    they do not.
    """
    out = np.zeros((2, len(x)))
    h, w = depth.shape
    weight = np.empty(3)
    for row in range(h):
        for column in range(w):
            if second[row, column] <= 0:
                continue
            k = seen[row, column]
            d = rays[:, 0] * (column + 0.5) + rays[:, 1] * (row + 0.5) + rays[:, 2]
            n = flat[k]
            p = eye + depth[row, column] * d
            for corner in range(3):
                b = x[faces[k, (corner + 1) % 3]]
                c = x[faces[k, (corner + 2) % 3]]
                e0 = b[1] - p[1]
                e1 = b[2] - p[2]
                e2 = b[0] - p[0]
                f0 = c[1] - p[1]
                f1 = c[2] - p[2]
                f2 = c[0] - p[0]
                weight[corner] = max(
                    n[0] * (e0 * f1 - e1 * f0)
                    + n[1] * (e1 * f2 - e2 * f1)
                    + n[2] * (e2 * f0 - e0 * f2),
                    0.0,
                )
            total = weight[0] + weight[1] + weight[2]
            if total <= 0:
                continue
            along = n[0] * d[0] + n[1] * d[1] + n[2] * d[2]
            for corner in range(3):
                at = faces[k, corner]
                m = normals[at]
                lever = max(n[0] * m[0] + n[1] * m[1] + n[2] * m[2], 0.0) / along
                out[0, at] += weight[corner] / total * lever * first[row, column]
                out[1, at] += weight[corner] / total * lever * lever * second[row, column]
    return out
