"""Bounces: as many as change what the photos show, by the shape alone.

Of the light that falls on a point of the surface, a part has been reflected off the object before.
Under an even sky, with diffuse albedo rho everywhere, radiosity (Goral et al. 1984) gives it:

    E_0 = 1 - K 1,    E_(k+1) = rho K E_k

K_pj is the share of point p's hemisphere, weighted by the cosine, in which it sees point j; E_k is
what arrives after k reflections. A convex object has K = 0 and needs no bounce. Leaving out all
reflections from the d-th on makes a point darker by the factor 1 - sum_(k >= d) E_k / sum_k E_k.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

from pipeline.base.runtime import mitsuba_rays
from pipeline.geometry.mesh_io import Mesh, sample_surface

# rho: that of white paint, for before the light is known photos cannot tell how white a thing is
ALBEDO = 0.8
# what may be lost, root mean square of the relative error over the points that photos show. The
# least relative error that refinement leaves on seven real sets is .14, to which this adds .1 dB in
# quadrature; a brighter base colour makes up for most of it.
TOLERANCE = 0.02
NODES = 1500  # random points of the surface that reflect onto the others
RAYS = 256  # of each, over its hemisphere
LIFT = 1e-4  # of the mesh's extent: how far rays start off the surface


def cosine_directions(normal: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """RAYS directions over the hemisphere of each normal (p, 3), with the density cosine / pi:
    (p, RAYS, 3). A normal plus a point of the unit sphere has it (Lambert's law).
    """
    ball = rng.normal(size=(len(normal), RAYS, 3))
    ball /= np.linalg.norm(ball, axis=-1, keepdims=True)
    direction = normal[:, None] + ball
    return direction / np.maximum(np.linalg.norm(direction, axis=-1, keepdims=True), 1e-9)


def what_points_see(
    scene: object,
    position: np.ndarray,
    normal: np.ndarray,
    lift: float,
    rng: np.random.Generator,
) -> sparse.csr_matrix:
    """K (p, p) of points with position and normal (p, 3), of which a ray meets the nearest."""
    direction = cosine_directions(normal, rng).reshape(-1, 3)
    start = np.repeat(position + lift * normal, RAYS, axis=0)
    si = scene.ray_intersect(mitsuba_rays(start, direction))  # type: ignore[attr-defined]
    hit = np.flatnonzero(np.array(si.is_valid()))
    met = cKDTree(position).query(np.array(si.p).T[hit])[1]

    share = np.full(len(hit), 1 / RAYS)
    return sparse.csr_matrix((share, (hit // RAYS, met)), (len(position), len(position)))


def arriving(sees: sparse.csr_matrix, orders: int) -> np.ndarray:
    """E_0 to E_(orders - 1), (orders, p), under an even sky of irradiance 1."""
    light = [1 - np.asarray(sees.sum(1)).ravel()]
    for _ in range(orders - 1):
        light.append(ALBEDO * (sees @ light[-1]))
    return np.stack(light)


def lost_share(light: np.ndarray, kept: int) -> float:
    """Root mean square over the points of the part of E_0 + E_1 + ..., (orders, p), that the first
    `kept` terms leave out.
    """
    total = np.maximum(light.sum(0), 1e-9)
    return float(np.sqrt(np.mean((light[kept:].sum(0) / total) ** 2)))


def path_vertices(
    scene: object,
    mesh: Mesh,
    seen: tuple[np.ndarray, np.ndarray],
    most: int,
    rng: np.random.Generator,
) -> tuple[int, dict]:
    """Mitsuba's max_depth, from 2 (direct light) to `most`, and the evidence: the least at which
    TOLERANCE or less is lost of what `most` has. seen: position and normal (p, 3) of points that
    the photos show.
    """
    elsewhere = sample_surface(mesh, NODES, rng)
    position, normal = (np.concatenate(pair) for pair in zip(seen, elsewhere, strict=True))
    lift = LIFT * float(np.ptp(mesh.vertices, axis=0).max())
    sees = what_points_see(scene, position, normal, lift, rng)

    shown = np.s_[: len(seen[0])]
    light = arriving(sees, most - 1)[:, shown]
    blocked = np.asarray(sees.sum(1)).ravel()[shown]
    lost = {depth: lost_share(light, depth - 1) for depth in range(2, most + 1)}
    chosen = min(depth for depth, share in lost.items() if share <= TOLERANCE)
    return chosen, {
        "hemisphere_blocked_by_the_object": {
            "mean": float(blocked.mean()),
            "95%": float(np.quantile(blocked, 0.95)),
        },
        "lost_share_by_max_depth": {str(depth): share for depth, share in lost.items()},
        "albedo": ALBEDO,
        "tolerance": TOLERANCE,
    }
