"""Light transport of chosen pixels as a linear operator: radiance = T(materials) light, for fixed
geometry.

Each row is one observed pixel; rows are grouped by surface point, seen from several views. With the
principled BSDF the material enters in closed form: f = (1 - m)(a A + S) + m (a M1 + (1 - a) M0) for
base colour a and metallic m, where A is the diffuse lobe, S the dielectric highlight, M1 and M0 the
metal one at a = 1 and a = 0; all depend on the roughness, for which there is a short list of
levels. (Exact to rounding for Mitsuba's `principled`; a test holds it to that.)

Direct light: one jittered direction per cell of a lat-long grid plus directions drawn from the
highlight, combined by the balance heuristic (Veach 1997), so that mirrors and chalk are both
resolved. Light from the object onto itself: radiosity between surface points, the emitters diffuse
with the albedo that the material's lobes have (Goral et al. 1984), as many bounces as the path
tracer is given.

Letters: n rows, p points, q radiosity nodes (the points first), M = h w light pixels in row-major
order.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import drjit as dr
import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

from pipeline.base.errors import InputError
from pipeline.base.runtime import mitsuba as mi
from pipeline.base.runtime import mitsuba_rays
from pipeline.geometry.mesh_io import load_mesh, sample_surface
from pipeline.render.envmap import directions, solid_angles, uv_from_direction
from pipeline.render.observe import Observations

LOBES = ("diffuse", "dielectric", "metal white", "metal black")
HIGHLIGHT_SAMPLES = 32  # directions per row drawn from the highlight
FINER = 16  # quadrature of a light pixel's hat, per side
ALBEDO_SAMPLES = 1 << 16  # of a lobe's albedo: good to .3 %
PATCH = 2.0  # radius in pixels over which photos are averaged
STEEP = 0.3  # rows with a smaller cosine of incidence are left out: their pixel covers much surface
LANES = 1 << 18  # directions evaluated at once: bounds memory, and keeps transposes in the cache


@dataclass
class Rows:
    """n views of p surface points, sorted by point: index of the central pixel among the
    observations, and of the point.

    patch (n, observations), rows of sum 1, averages over the pixels around the central one, all of
    the same view: less noise.
    """

    observation: np.ndarray
    point: np.ndarray
    patch: sparse.csr_matrix | None = None

    @property
    def starts(self) -> np.ndarray:
        """First row of each point (p,), for np.add.reduceat."""
        return np.flatnonzero(np.diff(self.point, prepend=-1))


def spread_out(points: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    """Indices of `count` points by farthest-point sampling."""
    if len(points) <= count:
        return np.arange(len(points))
    chosen = [int(rng.integers(len(points)))]
    distance = np.linalg.norm(points - points[chosen[0]], axis=1)
    for _ in range(count - 1):
        chosen.append(int(distance.argmax()))
        distance = np.minimum(distance, np.linalg.norm(points - points[chosen[-1]], axis=1))
    return np.array(chosen)


def choose_rows(
    observations: Observations, scene, points: int, views: int, seed: int, pool: int = 400_000
) -> Rows:
    """Points spread evenly over the seen surface, each with up to `views` patches of pixels that
    show it, one per view.
    """
    rng = np.random.default_rng(seed)
    usable = np.flatnonzero(observations.cosine > STEEP)
    if len(usable) < 50:
        raise InputError(
            "fewer than 50 observed pixels see the surface at a usable angle",
            "observe",
            "photograph the object from more sides, or check the mesh and the masks",
        )
    usable = np.sort(rng.choice(usable, min(pool, len(usable)), replace=False))
    o, d = observations.centre_rays(usable)
    si = scene.ray_intersect(mitsuba_rays(o, d))
    t, hit = np.array(si.t), np.array(si.is_valid()).astype(bool)
    usable, o, d, t = usable[hit], o[hit], d[hit], t[hit]
    position, footprint = (
        o + t[:, None] * d,
        np.median(t / observations.lens[observations.view[usable], 0]),
    )
    candidates = rng.choice(len(usable), min(4 * points, len(usable)), replace=False)
    candidates = candidates[spread_out(position[candidates], points, rng)]
    tree, rows, owner, members = cKDTree(position), [], [], []
    for p, near in enumerate(tree.query_ball_point(position[candidates], PATCH * footprint)):
        near = np.array(near)[
            np.argsort(
                np.linalg.norm(position[near] - position[candidates[p]], axis=1), kind="stable"
            )
        ]
        seen = observations.view[usable[near]]
        kept = rng.permutation(np.unique(seen, return_index=True)[1])[
            :views
        ]  # the nearest pixel of each view
        rows.append(usable[near[kept]])
        owner.append(np.full(len(kept), p))
        members += [usable[near[seen == seen[k]]] for k in kept]
    sizes = np.array([len(m) for m in members])
    patch = sparse.csr_matrix(
        (
            np.repeat(1 / sizes, sizes),
            (np.repeat(np.arange(len(sizes)), sizes), np.concatenate(members)),
        ),
        (len(sizes), len(observations)),
    )
    return Rows(np.concatenate(rows), np.concatenate(owner), patch)


def bilinear(d: np.ndarray, h: int) -> tuple[np.ndarray, np.ndarray]:
    """The four light pixels around directions d (k, 3) and their weights: indices, weights (k,
    4).
    """
    w, uv = 2 * h, uv_from_direction(d)
    x, y = uv[:, 0] * w - 0.5, np.clip(uv[:, 1] * h - 0.5, 0, h - 1)
    i, j = np.floor(x), np.minimum(np.floor(y), h - 2)
    fx, fy = x - i, y - j
    columns = [i % w, (i + 1) % w]
    index = np.stack([(j + b) * w + columns[a] for a in (0, 1) for b in (0, 1)], -1).astype(
        np.int64
    )
    weight = np.stack(
        [(fx if a else 1 - fx) * (fy if b else 1 - fy) for a in (0, 1) for b in (0, 1)], -1
    )
    return index, weight


def grid_directions(h: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """One direction per cell of an (h, 2h) grid, uniform in solid angle within the cell: (h 2h, 3),
    and solid angles.
    """
    sine = np.sin(np.pi * (0.5 - np.arange(h + 1) / h))
    z = sine[:-1, None] + rng.random((h, 2 * h)) * (sine[1:] - sine[:-1])[:, None]
    lon = 2 * np.pi * (0.5 - (np.arange(2 * h) + rng.random((h, 2 * h))) / (2 * h))
    c = np.sqrt(1 - z**2)
    return np.stack([c * np.sin(lon), z, c * np.cos(lon)], -1).reshape(-1, 3), solid_angles(
        h, 2 * h
    ).reshape(-1)


def light_weights(d: np.ndarray, solid: np.ndarray, h: int) -> sparse.csr_matrix:
    """Bilinear weights (k, M) of light pixels for directions d (k, 3) that stand for solid angles
    `solid` (k,), each pixel's scaled so that together it has the solid angle that its bilinear hat
    has. Jitter alone would make a lamp in one pixel a fifth brighter or darker than it is.
    """
    index, weight = bilinear(d, h)
    W = sparse.csr_matrix(
        (weight.ravel(), (np.repeat(np.arange(len(d)), 4), index.ravel())), (len(d), 2 * h * h)
    )
    return (W @ sparse.diags(hat_solid_angles(h) / (solid @ W))).tocsr()


@lru_cache
def hat_solid_angles(h: int) -> np.ndarray:
    """Integral (M,) over the sphere of the bilinear hat of every pixel of a light with h rows."""
    fine = FINER * h
    index, weight = bilinear(directions(fine, 2 * fine).reshape(-1, 3), h)
    return np.bincount(
        index.ravel(), (weight * solid_angles(fine, 2 * fine).reshape(-1, 1)).ravel(), 2 * h * h
    )


def lobe(metallic: float, color: float, roughness: float):
    return mi.load_dict(
        {
            "type": "principled",
            "specular": 0.5,
            "base_color": {"type": "rgb", "value": color},
            "metallic": metallic,
            "roughness": roughness,
        }
    )


class Lobes:
    """The four parts of the BSDF at one roughness, times the cosine, for directions in the local
    frame.
    """

    def __init__(self, roughness: float):
        self.parts = [
            lobe(m, a, roughness) for m, a in ((0.0, 1.0), (0.0, 0.0), (1.0, 1.0), (1.0, 0.0))
        ]
        self.context = mi.BSDFContext()

    def __call__(self, si, wo) -> np.ndarray:
        """(4, lanes) in the order of LOBES."""
        white, black, metal, edge = (np.array(b.eval(self.context, si, wo)[0]) for b in self.parts)
        return np.stack([white - black, black, metal, edge])

    def highlight_density(self, si, wo) -> np.ndarray:
        return np.array(self.parts[2].pdf(self.context, si, wo))

    def sample_highlight(self, si, seed: int):
        """Local directions drawn from the highlight, one per lane."""
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(seed, dr.width(si.wi))
        return self.parts[2].sample(self.context, si, sampler.next_1d(), sampler.next_2d())[0].wo


@lru_cache
def lobe_albedo(roughness: float) -> np.ndarray:
    """Share of uniform light that each lobe reflects (4,): f cos over both hemispheres' cosines, by
    the balance heuristic between directions of the diffuse lobe and of the highlight. A rough metal
    has no more than .4, for what its facets reflect twice is not in the BSDF.
    """
    lobes, rng, n = Lobes(roughness), np.random.default_rng(0), ALBEDO_SAMPLES
    si = dr.zeros(mi.SurfaceInteraction3f, n)
    si.wi = cosine_directions(n, rng)
    total = np.zeros(4)
    for wo in (cosine_directions(n, rng), lobes.sample_highlight(si, 0)):
        density = np.array(dr.maximum(wo.z, 0)) / np.pi + lobes.highlight_density(si, wo)
        total += (np.nan_to_num(lobes(si, wo)) / np.maximum(density, 1e-6)).mean(1)
    return total


def cosine_directions(n: int, rng: np.random.Generator):
    """n directions in the local frame with density cosine / pi."""
    square = mi.Point2f(rng.random((2, n), np.float32))
    return mi.warp.square_to_cosine_hemisphere(square)


class Transport:
    """T for rows of a scene. Build once per geometry; `at` gives the lobes' matrices for one
    roughness level.

    scene: Mitsuba scene with the mesh; rows: from `choose_rows`; h: rows of the light; nodes:
    radiosity points added where no photo looks. Seeds fix the jitter.
    """

    def __init__(
        self,
        scene,
        mesh_path,
        observations: Observations,
        rows: Rows,
        h: int,
        nodes: int,
        seed: int,
    ):
        self.scene, self.rows, self.h, self.rng = scene, rows, h, np.random.default_rng([7, seed])
        o, d = observations.centre_rays(rows.observation)
        si = scene.ray_intersect(mitsuba_rays(o, d))
        self.frame = np.stack(
            [np.array(v).T for v in (si.sh_frame.s, si.sh_frame.t, si.sh_frame.n)], 1
        )  # (n, 3, 3)
        self.incident = np.einsum("nij,nj->ni", self.frame, -d).astype(
            np.float32
        )  # local, towards the camera
        self.position = np.array(si.p).T
        self.sample_h = max(h, 32)
        self.d, self.solid = grid_directions(self.sample_h, self.rng)
        self.to_light = light_weights(self.d, self.solid, h)
        first = rows.starts
        self._place_nodes(mesh_path, self.position[first], self.frame[first, 2], nodes)
        self._visibility()

    def _place_nodes(self, mesh_path, points, normals, extra: int) -> None:
        """Radiosity nodes: the rows' points, then random ones over the whole surface; each knows
        its nearest point.
        """
        mesh = load_mesh(mesh_path)
        where, facing = sample_surface(mesh, extra, self.rng)
        self.node_position = np.concatenate([points, where])
        self.node_normal = np.concatenate([normals, facing])
        self.node_point = np.concatenate([np.arange(len(points)), cKDTree(points).query(where)[1]])
        self.node_tree = cKDTree(self.node_position)
        self.reach = 1e-4 * float(np.ptp(mesh.vertices, axis=0).max())

    def _trace(self, origin, normal, d) -> np.ndarray:
        """Radiosity node each ray from a surface meets (k,), -1 where it leaves to the light."""
        out = np.full(len(d), -1)
        for k in range(0, len(d), LANES):
            part = np.s_[k : k + LANES]
            side = np.sign((normal[part] * d[part]).sum(1, keepdims=True))
            si = self.scene.ray_intersect(
                mitsuba_rays(origin[part] + self.reach * side * normal[part], d[part])
            )
            hit = np.array(si.is_valid()).astype(bool)
            if hit.any():
                out[k : k + LANES][hit] = self.node_tree.query(np.array(si.p).T[hit])[1]
        return out

    def _visibility(self) -> None:
        """Which cell of the grid each node sees, or which node stands before it: (q, cells),
        int32.
        """
        q, cells = len(self.node_position), len(self.d)
        self.meets = np.full((q, cells), -2, np.int32)  # -2: below the horizon
        cosine = self.node_normal @ self.d.T
        rows, columns = np.nonzero(cosine > 0)
        self.meets[rows, columns] = self._trace(
            self.node_position[rows], self.node_normal[rows], self.d[columns]
        )
        weight = np.where(cosine > 0, cosine, 0) * self.solid / np.pi
        self.sees = np.ascontiguousarray(
            (self.to_light.T @ np.where(self.meets == -1, weight, 0).T).T, np.float32
        )  # (q, M)
        rows, columns = np.nonzero(self.meets >= 0)
        self.between = sparse.csr_matrix(
            (weight[rows, columns], (rows, self.meets[rows, columns])), (q, q)
        )

    def _interaction(self, rows: np.ndarray):
        """Surface interaction that knows its local incident direction only, a lane for every one of
        `rows`.
        """
        si = dr.zeros(mi.SurfaceInteraction3f, len(rows))
        si.wi = mi.Vector3f(np.ascontiguousarray(self.incident[rows].T))
        return si

    def at(self, roughness: float, seed: int) -> tuple[np.ndarray, list]:
        """Lobes at one roughness: light matrices F (4, n, M) float32 and a list of 4 sparse (n, q)
        for light off the object.
        """
        lobes, n, cells, to_light = (
            Lobes(roughness),
            len(self.rows.point),
            len(self.d),
            self.to_light.astype(np.float32),
        )
        F = np.empty((4, n, 2 * self.h**2), np.float32)
        off = [[], [], []]  # row, node, values (4,)
        chunk = max(1, LANES // cells)
        for k in range(0, n, chunk):
            mine = np.arange(k, min(k + chunk, n))
            above = np.flatnonzero(
                self.meets[self.rows.point[mine]] != -2
            )  # the rest would be zero
            row, cell = mine[above // cells], above % cells
            local = (
                (self.frame[mine].astype(np.float32) @ self.d.T.astype(np.float32))
                .transpose(1, 0, 2)
                .reshape(3, -1)
            )
            si, wo = self._interaction(row), mi.Vector3f(np.ascontiguousarray(local[:, above]))
            density = 1 / self.solid[cell] + HIGHLIGHT_SAMPLES * lobes.highlight_density(si, wo)
            value = np.nan_to_num(lobes(si, wo)) / density.astype(np.float32)
            meets = self.meets[self.rows.point[row], cell]
            grid = np.zeros((4, len(mine) * cells), np.float32)
            grid[:, above] = np.where(meets == -1, value, 0)
            F[:, mine] = (grid.reshape(-1, cells) @ to_light).reshape(4, len(mine), -1)
            blocked = np.flatnonzero((meets >= 0) & (value[2] > 0))
            for store, what in zip(off, (row[blocked], meets[blocked], value[:, blocked].T)):
                store.append(what)
        self._add_highlights(lobes, F, off, seed)
        row, node, value = (np.concatenate(x) for x in off)
        return F, [
            sparse.csr_matrix((value[:, c], (row, node)), (n, len(self.node_position)))
            for c in range(4)
        ]

    def _add_highlights(self, lobes: Lobes, F: np.ndarray, off: list, seed: int) -> None:
        """The highlight's own directions, balance heuristic against the grid's."""
        n = len(self.rows.point)
        row = np.repeat(np.arange(n), HIGHLIGHT_SAMPLES)
        si = self._interaction(row)
        wo = lobes.sample_highlight(si, seed)
        local = np.array(wo).T
        d = np.einsum("nji,nj->ni", self.frame[row], local)
        good = (local[:, 2] > 0) & np.isfinite(d).all(1)
        latitude = uv_from_direction(np.where(good[:, None], d, [0, 1, 0]))[:, 1]
        cell_row = np.clip((latitude * self.sample_h).astype(int), 0, self.sample_h - 1)
        solid = self.solid.reshape(self.sample_h, -1)[cell_row, 0]
        density = 1 / solid + HIGHLIGHT_SAMPLES * lobes.highlight_density(si, wo)
        value = np.where(good, np.nan_to_num(lobes(si, wo)), 0) / density
        meets = np.full(len(row), -2)
        meets[good] = self._trace(self.position[row[good]], self.frame[row[good], 2], d[good])
        free = np.flatnonzero(meets == -1)
        index, weight = bilinear(d[free], self.h)
        for c in range(4):
            np.add.at(
                F[c],
                (row[free][:, None], index),
                (value[c, free, None] * weight).astype(np.float32),
            )
        blocked = np.flatnonzero(meets >= 0)
        for store, what in zip(off, (row[blocked], meets[blocked], value[:, blocked].T)):
            store.append(what)

    def exitant(self, light: np.ndarray, albedo: np.ndarray, bounces: int) -> np.ndarray:
        """Radiance (q, 3) that the nodes give off under `light` (M, 3), for diffuse albedo (p, 3)
        of the points.

        bounces: how many reflections the light has behind it at most, the node's own included.
        """
        rho = albedo[self.node_point]
        first = rho * (self.sees @ light.astype(np.float32))
        out = first
        for _ in range(bounces - 1):
            out = first + rho * (self.between @ out)
        return out
