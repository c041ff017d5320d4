"""Light transport of chosen pixels as a linear operator: radiance = T(materials) light, for fixed
geometry.

Each row is the mean over a patch of observed pixels (rows.py). The material enters through the four
lobes of its BSDF (principled_lobes.py), so T is a mix of four matrices per roughness.

A row has RAYS rays, through random places in its patch's pixels, each with the shading normal that
it meets: a highlight on a curved patch is as broad as the photos' mean of it. Every direction of
light is looked at for one of the rays only, neighbouring directions for different ones, so that a
patch costs as much as a pixel. Where the mesh's normals are in error, that part of their spread in
a patch is taken out (`without_error`); it is an unknown of the sampler's
(posterior/split_gibbs/normal_spread.py).

Direct light: one jittered direction per cell of a lat-long grid plus directions drawn from the
highlight, combined by the balance heuristic (Veach 1997), so that mirrors and chalk are both
resolved. Light from the object onto itself: radiosity between surface points, the emitters diffuse
with the albedo that the material's lobes have (Goral et al. 1984), as many bounces as the path
tracer is given.

Light from the ground (surroundings.py), where it is known: what the rows reflect of it stands in
three more columns of the matrices for light off the object, one for each channel, whose nodes give
off 1 in that channel. It hides the light below it.

Letters: n rows, R rays of each, p points, q radiosity nodes (the points first), M = h w light
pixels in row-major order, F the lobes' light matrices; si is a Mitsuba surface interaction and wo
an outgoing direction in its local frame.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import drjit as dr
import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

from pipeline.base.runtime import mitsuba as mi
from pipeline.base.runtime import mitsuba_rays
from pipeline.geometry.mesh_io import sample_surface
from pipeline.geometry.surface import Surface
from pipeline.render.envmap import uv_from_direction
from pipeline.render.light_grid import bilinear, grid_directions, light_weights, lit_by, spread_onto
from pipeline.render.observe import Observations
from pipeline.render.principled_lobes import LOBES, PrincipledLobes
from pipeline.render.rows import CONE, Rows
from pipeline.render.shading_normals import shading_normals
from pipeline.render.surroundings import Ground

RAYS = 8  # of a row that is the mean over a patch
HIGHLIGHT_SAMPLES = 64  # directions per row drawn from the highlight
# steps of a sequence that fills the unit square evenly: powers of the plastic number (Roberts 2018)
EVEN_STEPS = 0.7548776662466927, 0.5698402909980532
LANES = 1 << 18  # directions evaluated at once: bounds memory, and keeps transposes in the cache
FINEST_GRID = 32  # rows of the direction grid where the light itself is coarser
LIFT = 1e-4  # of the mesh's extent: how far rays start off the surface
LIGHT = -1  # what a ray meets, instead of a node's number: nothing, it leaves to the light
BELOW = -2  # no ray at all: the direction lies below the horizon
GROUND = -3  # the ground that the object stands on


class Reflected:
    """What n rows reflect at one roughness, collected in parts: from the light F (4, n, M), from
    the ground `of_ground` (4, n, 3), and from the object itself.
    """

    def __init__(self, roughness: float, rows: int, pixels: int):
        self.lobes = PrincipledLobes(roughness)
        self.F = np.zeros((len(LOBES), rows, pixels), np.float32)
        self.of_ground = np.zeros((len(LOBES), rows, 3), np.float32)
        self.blocked: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []

    def block(self, row: np.ndarray, node: np.ndarray, value: np.ndarray) -> None:
        """Values (4, k) by which rows (k,) reflect what nodes (k,) give off."""
        self.blocked.append((row, node, value))

    def from_ground(self, row: np.ndarray, radiance: np.ndarray, value: np.ndarray) -> None:
        """Values (4, k) by which rows (k,) reflect the ground's radiance (k, 3)."""
        for lobe, of_lobe in enumerate(value):
            np.add.at(self.of_ground[lobe], row, of_lobe[:, None] * radiance)

    def off_object(self, nodes: int) -> list[sparse.csr_matrix]:
        """One (n, nodes) matrix per lobe."""
        row, node, value = (np.concatenate(parts, -1) for parts in zip(*self.blocked))
        shape = self.F.shape[1], nodes
        return [sparse.csr_matrix((of_lobe, (row, node)), shape) for of_lobe in value]


@dataclass
class Lanes:
    """Rows and directions of the grid that they are lit from, k pairs: number of the row and of the
    cell (k,), what the row's point meets there (k,), and both directions in the row's frame.
    """

    row: np.ndarray
    cell: np.ndarray
    meets: np.ndarray
    si: Any
    wo: Any


@dataclass
class Hits:
    """Where k rays meet the surface: whether they do (k,); position, shading normal with and
    without the normal map, and the ray's own direction, (k, 3) each.
    """

    valid: np.ndarray
    position: np.ndarray
    normal: np.ndarray
    unmapped: np.ndarray
    direction: np.ndarray

    def where(self, chosen: np.ndarray, other: Hits) -> Hits:
        """These where `chosen` (k,) holds, those of `other` elsewhere."""
        column = chosen[:, None]
        return Hits(
            np.where(chosen, self.valid, other.valid),
            np.where(column, self.position, other.position),
            np.where(column, self.normal, other.normal),
            np.where(column, self.unmapped, other.unmapped),
            np.where(column, self.direction, other.direction),
        )


def meet(scene: Any, surface: Surface, rays: tuple[np.ndarray, np.ndarray]) -> Hits:
    """First hits of rays, origins and directions (k, 3), on the mesh with its normal map."""
    si = scene.ray_intersect(mitsuba_rays(*rays))
    valid = np.array(si.is_valid()).astype(bool)
    mapped = shading_normals(si, surface)
    return Hits(valid, np.array(si.p).T, mapped, np.array(si.sh_frame.n).T, rays[1])


def even_points(count: int, seed: int) -> np.ndarray:
    """HIGHLIGHT_SAMPLES points of the unit square for each of `count` rows (2, count x samples),
    evenly spread and shifted at random from row to row (Cranley and Patterson 1976).
    """
    shift = np.random.default_rng([11, seed]).random((count, 1, 2))
    steps = np.arange(HIGHLIGHT_SAMPLES)[:, None] * np.array(EVEN_STEPS)
    return ((steps + shift) % 1).reshape(-1, 2).T


def without_error(normal: np.ndarray, sigma: float) -> np.ndarray:
    """Unit normals (n, R, 3) of each row's rays, drawn towards the row's mean so far that their
    variance loses sigma^2 per axis, the mesh's error (radians); to the mean itself where there
    is no more than that.
    """
    mean = normal.mean(1, keepdims=True)
    mean /= np.linalg.norm(mean, axis=-1, keepdims=True)
    variance = ((normal - mean) ** 2).sum(-1).mean(1) / 2
    kept = np.sqrt(np.maximum(1 - sigma**2 / np.maximum(variance, 1e-12), 0))
    drawn = mean + (kept[:, None, None] if sigma > 0 else 1.0) * (normal - mean)
    return drawn / np.linalg.norm(drawn, axis=-1, keepdims=True)


class Transport:
    """T for rows of a scene. Build once per geometry; `at` gives the lobes' matrices for one
    roughness.

    scene: Mitsuba scene with the mesh; rows: from `choose_rows`; h: rows of the light; nodes:
    radiosity points added where no photo looks. `seed` fixes the jitter. normal_error: deviation of
    the mesh's normals from the object's per axis, radians. ground: what the object stands on.
    """

    def __init__(
        self,
        scene: Any,
        mesh: Path,
        observations: Observations,
        rows: Rows,
        h: int,
        nodes: int,
        seed: int,
        normal_error: float = 0.0,
        ground: Ground | None = None,
    ):
        self.scene = scene
        self.ground = ground
        self.rows = rows
        self.h = h
        self.rng = np.random.default_rng([7, seed])

        surface = Surface.of(mesh)
        self._meet_surface(surface, observations, normal_error)
        self._lay_grid()
        self._place_nodes(surface, nodes)
        self._look_around()

    def _meet_surface(
        self, surface: Surface, observations: Observations, normal_error: float
    ) -> None:
        """Of every row's rays: where they meet the surface (n, R, 3), shading frame (n, R, 3, 3:
        its rows are s, t and the mapped normal), unmapped normal and local direction to the camera
        (n, R, 3); and the row's position (n, 3), its central pixel's.
        """
        count = 1 if self.rows.patch is None else RAYS
        hits = self._hits(surface, observations, self.rows.rays(count, self.rng))
        in_rows = lambda values: values.reshape(-1, count, 3)

        normal = without_error(in_rows(hits.normal), normal_error)
        frame = mi.Frame3f(mi.Vector3f(np.ascontiguousarray(normal.reshape(-1, 3).T)))
        axes = [in_rows(np.array(axis).T) for axis in (frame.s, frame.t, frame.n)]
        self.frame = np.stack(axes, 2)
        self.incident = np.einsum("nrij,nrj->nri", self.frame, -in_rows(hits.direction))
        self.incident = self.incident.astype(np.float32)
        self.ray_position = in_rows(hits.position)
        self.ray_normal = in_rows(hits.unmapped)
        central = observations.centre_rays(self.rows.observation)
        self.position = meet(self.scene, surface, central).position

    def _hits(self, surface: Surface, observations: Observations, rays: np.ndarray) -> Hits:
        """Of rays through the pixels `rays` (n, R): through a random place in each where the rows
        have patches; through its centre where that ray strays beyond an edge, or without patches.
        """
        through = rays.ravel()
        centre = meet(self.scene, surface, observations.centre_rays(through))
        if self.rows.patch is None:
            return centre

        jittered = meet(self.scene, surface, observations.rays(through, self.rng))
        alike = (jittered.unmapped * centre.unmapped).sum(-1) > np.cos(np.radians(CONE))
        return jittered.where(jittered.valid & alike, centre)

    def _lay_grid(self) -> None:
        """One direction per cell of a grid over the sphere, what each sees of the light, and
        which of a row's rays it is looked at for (cells,): all of them within as many
        neighbours.
        """
        self.grid_rows = max(self.h, FINEST_GRID)
        self.cell_direction, self.cell_solid_angle = grid_directions(self.grid_rows, self.rng)
        weights = light_weights(self.cell_direction, self.cell_solid_angle, self.h)
        self.to_light = weights.astype(np.float32)

        row, column = np.divmod(np.arange(len(self.cell_direction)), 2 * self.grid_rows)
        self.cell_ray = (column + 3 * row) % self.frame.shape[1]

    def _place_nodes(self, surface: Surface, extra: int) -> None:
        """Radiosity nodes: the rows' points, then `extra` random ones over the whole surface; each
        knows its nearest point.
        """
        first = self.rows.starts
        points = self.position[first]
        mesh = surface.geometry
        elsewhere, facing = sample_surface(mesh, extra, self.rng)
        nearest = cKDTree(points).query(elsewhere)[1]

        self.node_position = np.concatenate([points, elsewhere])
        normal = self.ray_normal[first].mean(1)
        normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
        self.node_normal = np.concatenate([normal, facing])
        self.node_point = np.concatenate([np.arange(len(points)), nearest])
        self.node_tree = cKDTree(self.node_position)
        self.lift = LIFT * float(np.ptp(mesh.vertices, axis=0).max())

    def _look_around(self) -> None:
        """What each node meets in every cell's direction, (q, cells) int32, and from it the light
        (q, M) and the other nodes (q, q) that it sees, weighted by cosine and solid angle over pi;
        and what the ground gives it that way (q, 3).
        """
        cosine = self.node_normal @ self.cell_direction.T
        nodes, cells = np.nonzero(cosine > 0)
        self.meets = np.full(cosine.shape, BELOW, np.int32)
        self.meets[nodes, cells] = self._trace(
            self.node_position[nodes], self.node_normal[nodes], self.cell_direction[cells]
        )

        weight = np.where(cosine > 0, cosine, 0) * self.cell_solid_angle / np.pi
        free = np.where(self.meets == LIGHT, weight, 0)
        self.sees = np.ascontiguousarray((self.to_light.T @ free.T).T, np.float32)

        nodes, cells = np.nonzero(self.meets >= 0)
        self.between = sparse.csr_matrix(
            (weight[nodes, cells], (nodes, self.meets[nodes, cells])),
            (len(cosine), len(cosine)),
        )
        self.ground_light = np.zeros((len(cosine), 3), np.float32)
        if self.ground is not None:
            self.ground_seen = self._look_at(self.ground)
            self.ground_light = np.einsum("qc,qck->qk", weight.astype(np.float32), self.ground_seen)

    def _look_at(self, ground: Ground) -> np.ndarray:
        """Radiance (q, cells, 3) of the ground that every node sees in every cell's direction; 0
        where it meets something else.
        """
        seen = np.zeros((*self.meets.shape, 3), np.float32)
        for node, meets in enumerate(self.meets):
            met = meets == GROUND
            origin = np.broadcast_to(self.node_position[node], (met.sum(), 3))
            seen[node, met] = ground.seen(origin, self.cell_direction[met])[1]
        return seen

    def with_ground(self, radiance: np.ndarray) -> np.ndarray:
        """Exitant radiance of the nodes (q, 3) and of the ground's three columns: (q + 3, 3), or as
        it is where there is no ground.
        """
        return radiance if self.ground is None else np.concatenate([radiance, np.eye(3)])

    def _trace(self, origin: np.ndarray, normal: np.ndarray, direction: np.ndarray) -> np.ndarray:
        """What rays from a surface meet (k,): a radiosity node, GROUND or LIGHT. All arguments (k,
        3).
        """
        meets = np.full(len(direction), LIGHT)
        for k in range(0, len(direction), LANES):
            part = np.s_[k : k + LANES]
            side = np.sign((normal[part] * direction[part]).sum(1, keepdims=True))
            start = origin[part] + self.lift * side * normal[part]

            si = self.scene.ray_intersect(mitsuba_rays(start, direction[part]))
            hit = np.array(si.is_valid()).astype(bool)
            if hit.any():
                meets[part][hit] = self.node_tree.query(np.array(si.p).T[hit])[1]
        if self.ground is not None:
            free = np.flatnonzero(meets == LIGHT)
            met, _ = self.ground.seen(origin[free], direction[free])
            meets[free[met]] = GROUND
        return meets

    def _interaction(self, rows: np.ndarray, rays: np.ndarray) -> Any:
        """Surface interaction that knows its local incident direction only, a lane for every one of
        `rows` and its ray of `rays`.
        """
        si = dr.zeros(mi.SurfaceInteraction3f, len(rows))
        si.wi = mi.Vector3f(np.ascontiguousarray(self.incident[rows, rays].T))
        return si

    def at(self, roughness: float, seed: int) -> tuple[np.ndarray, list[sparse.csr_matrix]]:
        """Lobes at one roughness: light matrices F (4, n, M) float32 and a list of 4 sparse (n, q)
        for light off the object, or (n, q + 3) with the ground's columns.
        """
        return self.at_each([roughness], [seed])[0]

    def at_each(
        self, roughness: list[float], seeds: list[int]
    ) -> list[tuple[np.ndarray, list[sparse.csr_matrix]]]:
        """`at` every roughness with its seed: what is of the geometry is worked out once."""
        n = len(self.rows.point)
        found = [Reflected(r, n, 2 * self.h**2) for r in roughness]
        chunk = max(1, LANES // len(self.cell_direction))
        for k in range(0, n, chunk):
            lanes = self._lanes(np.arange(k, min(k + chunk, n)))
            for reflected in found:
                self._over_the_grid(reflected, lanes)
        for reflected, seed in zip(found, seeds):
            self._add_highlights(reflected, seed)
        return [(reflected.F, self._off_object(reflected)) for reflected in found]

    def _off_object(self, reflected: Reflected) -> list[sparse.csr_matrix]:
        """The matrices for light off the object, with the ground's columns where there is one."""
        matrices = reflected.off_object(len(self.node_position))
        if self.ground is None:
            return matrices
        return [sparse.hstack(pair, "csr") for pair in zip(matrices, reflected.of_ground)]

    def _lanes(self, rows: np.ndarray) -> Lanes:
        """Every one of `rows` with every direction above the horizon of its point."""
        cells = len(self.cell_direction)
        above = np.flatnonzero(self.meets[self.rows.point[rows]] != BELOW)
        row, cell = rows[above // cells], above % cells
        return Lanes(
            row,
            cell,
            self.meets[self.rows.point[row], cell],
            self._interaction(row, self.cell_ray[cell]),
            mi.Vector3f(np.ascontiguousarray(self._local_cells(rows)[:, above])),
        )

    def _over_the_grid(self, reflected: Reflected, lanes: Lanes) -> None:
        """Add what comes from the grid's directions, balance heuristic against the highlight's."""
        lobes, meets, row, cell = reflected.lobes, lanes.meets, lanes.row, lanes.cell
        density = 1 / self.cell_solid_angle[cell]
        density = density + HIGHLIGHT_SAMPLES * lobes.highlight_density(lanes.si, lanes.wo)
        value = np.nan_to_num(lobes(lanes.si, lanes.wo)) / density.astype(np.float32)

        # every lobe is zero where the direction lies below the row's own shading horizon
        off_object = np.flatnonzero((meets >= 0) & (value[2] > 0))
        reflected.block(row[off_object], meets[off_object], value[:, off_object])
        if self.ground is not None:
            met = np.flatnonzero(meets == GROUND)
            radiance = self.ground_seen[self.rows.point[row[met]], cell[met]]
            reflected.from_ground(row[met], radiance, value[:, met])

        lit = np.where(meets == LIGHT, value, 0)
        T = self.to_light
        spread_onto(reflected.F, lit, row, cell, T.indptr, T.indices, T.data)

    def _local_cells(self, rows: np.ndarray) -> np.ndarray:
        """The grid's directions in the frames of the rays that look at them, (3, rows x cells)."""
        local = np.empty((3, len(rows), len(self.cell_direction)), np.float32)
        for ray in range(self.frame.shape[1]):
            mine = self.cell_ray == ray
            frame = self.frame[rows, ray].astype(np.float32)
            seen = frame @ self.cell_direction[mine].T.astype(np.float32)
            local[:, :, mine] = seen.transpose(1, 0, 2)
        return local.reshape(3, -1)

    def _add_highlights(self, reflected: Reflected, seed: int) -> None:
        """Add what comes from the highlight's own directions, balance heuristic against the
        grid's.
        """
        lobes = reflected.lobes
        row = np.repeat(np.arange(len(self.rows.point)), HIGHLIGHT_SAMPLES)
        ray = np.arange(len(row)) % self.frame.shape[1]
        si = self._interaction(row, ray)
        wo = lobes.sample_highlight(si, even_points(len(self.rows.point), seed))
        local = np.array(wo).T
        direction = np.einsum("nji,nj->ni", self.frame[row, ray], local)
        # a mapped normal may see below the surface
        above = (self.ray_normal[row, ray] * direction).sum(1) > 0
        good = (local[:, 2] > 0) & above & np.isfinite(direction).all(1)

        solid_angle = self._solid_angle_around(np.where(good[:, None], direction, [0, 1, 0]))
        density = 1 / solid_angle + HIGHLIGHT_SAMPLES * lobes.highlight_density(si, wo)
        value = np.where(good, np.nan_to_num(lobes(si, wo)), 0) / density

        meets = np.full(len(row), BELOW)
        start = row[good], ray[good]
        meets[good] = self._trace(self.ray_position[start], self.ray_normal[start], direction[good])

        free = np.flatnonzero(meets == LIGHT)
        pixel, weight = bilinear(direction[free], self.h)
        pointer, weight = pixel.shape[1] * np.arange(len(free) + 1), weight.astype(np.float32)
        lit, every = value[:, free].astype(np.float32), np.arange(len(free))
        spread_onto(reflected.F, lit, row[free], every, pointer, pixel.ravel(), weight.ravel())

        off_object = np.flatnonzero(meets >= 0)
        reflected.block(row[off_object], meets[off_object], value[:, off_object])
        if self.ground is not None:
            met = np.flatnonzero(meets == GROUND)
            start = self.ray_position[row[met], ray[met]]
            radiance = self.ground.seen(start, direction[met])[1]
            reflected.from_ground(row[met], radiance, value[:, met])

    def _solid_angle_around(self, direction: np.ndarray) -> np.ndarray:
        """Solid angle (k,) of the grid's cell that each direction (k, 3) falls into."""
        v = uv_from_direction(direction)[:, 1]
        cell_row = np.clip((v * self.grid_rows).astype(int), 0, self.grid_rows - 1)
        return self.cell_solid_angle.reshape(self.grid_rows, -1)[cell_row, 0]

    def irradiance(self, light: np.ndarray) -> np.ndarray:
        """Of the nodes by a light (M, 3) and the ground, (q, 3), over pi: what white ones give."""
        return lit_by(light, self.sees) + self.ground_light

    def exitant(self, irradiance: np.ndarray, albedo: np.ndarray, bounces: int) -> np.ndarray:
        """Radiance (q, 3) that the nodes give off under `irradiance` (q, 3), for diffuse albedo (p,
        3) of the points.

        bounces: how many reflections the light has behind it at most, the node's own included.
        """
        node_albedo = albedo[self.node_point]
        once_reflected = node_albedo * irradiance

        radiance = once_reflected
        for _ in range(bounces - 1):
            radiance = once_reflected + node_albedo * (self.between @ radiance)
        return radiance
