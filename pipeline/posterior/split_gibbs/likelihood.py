"""Likelihood of the photos' rows as a function of the light, for fixed materials.

The light is (M, 3) radiance of the operator's pixels. Base colours of the points are integrated out
(row_model.py). Around a light, the log-likelihood is that of whitened rows (`expansion`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch
from scipy import sparse

from pipeline.posterior.problem import ALBEDO_MAX
from pipeline.posterior.seen_light import SeenLight
from pipeline.posterior.split_gibbs.lobes import LobeTable, mix, neighbours
from pipeline.posterior.split_gibbs.row_loops import mix_into, seen_rows, whitened_into
from pipeline.posterior.split_gibbs.row_model import RowData, RowModel
from pipeline.posterior.split_gibbs.state import Noise, RegionMaterials, State
from pipeline.render.light_grid import lit_by


def point_materials(
    data: RowData, materials: RegionMaterials, offsets: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Roughness step and metallic of every point's own material, (p,) each, from the regions' and
    the points' offsets (3, p) (`coherence.OFFSETS`); as metallic as a point of its roughness can
    be.
    """
    region, lobes = data.region, data.lobes
    roughness = np.clip(materials.roughness[region] + offsets[0], 0, len(lobes.roughness) - 1)
    of_region = materials.metallic[region]
    metallic = np.choose(offsets[1], [of_region, 1 - of_region])
    return roughness, np.minimum(metallic, lobes.most_metallic[roughness])


def point_lobes(
    data: RowData, materials: RegionMaterials, offsets: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Roughness step of the lobe that every point shows, its normals spreading as offsets (3, p)
    say, and its metallic, (p,) each.
    """
    roughness, metallic = point_materials(data, materials, offsets)
    return data.lobes.blurred[roughness, offsets[2]], metallic


def seen_by(
    data: RowData, seen: np.ndarray, materials: RegionMaterials, offsets: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """U and W (n, 3) from what every lobe sees of the light, `seen` (steps, 4, n, 3)."""
    return seen_rows(seen, *point_lobes(data, materials, offsets), data.bounds)


@dataclass(frozen=True)
class Mixed:
    """U and W of all rows at the materials of their points: matrices (n, M) for the light, sparse
    (n, q) for light that comes off the object.
    """

    U: torch.Tensor
    W: torch.Tensor
    off_U: sparse.csr_matrix
    off_W: sparse.csr_matrix


def mixed(data: RowData, roughness: np.ndarray, metallic: np.ndarray) -> Mixed:
    """The lobes of every row at its point's `point_lobes`, (p,) each."""
    lobes: LobeTable = data.lobes
    n, M = lobes.direct[0].shape[1:]
    U, W = torch.empty(n, M), torch.empty(n, M)
    off_U = off_W = sparse.csr_matrix(lobes.off[0][0].shape)

    step = roughness[data.rows.point]
    m = metallic[data.rows.point]
    low, high, way = neighbours(step, len(lobes.off))
    for k in np.unique(low):
        index = np.flatnonzero(low == k)
        below, above = lobes.direct[k].numpy(), lobes.direct[high[index[0]]].numpy()
        between, kind = way[index].astype(np.float32), m[index].astype(np.float32)
        mix_into(below, above, between, kind, index, U.numpy(), W.numpy())

    for k in np.union1d(low, high[way > 0]):
        part = np.where(low == k, 1 - way, 0) + np.where(high == k, way, 0)
        black, white = (sparse.diags(part * of_kind) for of_kind in (1 - m, m))
        diffuse, highlight, metal_white, metal_black = lobes.off[k]
        off_U = off_U + black @ diffuse + white @ (metal_white - metal_black)
        off_W = off_W + black @ highlight + white @ metal_black
    return Mixed(U, W, off_U, off_W)


class Mixer:
    """`mixed` for the rows of a draw; remembers the last answer, for most moves change colours
    only, and half of a sweep's time would go into the same matrices again.
    """

    def __init__(self, data: RowData):
        self.data = data
        self.last: tuple[tuple[bytes, bytes], Mixed] | None = None

    def __call__(self, roughness: np.ndarray, metallic: np.ndarray) -> Mixed:
        key = (roughness.tobytes(), metallic.tobytes())
        if self.last is None or self.last[0] != key:
            self.last = key, mixed(self.data, roughness, metallic)
        return self.last[1]


@dataclass
class Whitener:
    """(I - shrink u u') diag(scale) point by point: what makes one channel's rows independent with
    deviation 1. scale (n, 1), unit vectors u (n, 1), shrink (p, 1), point of every row (n,).
    """

    scale: torch.Tensor
    unit: torch.Tensor
    shrink: torch.Tensor
    point: torch.Tensor

    def without(self, x: torch.Tensor) -> torch.Tensor:
        along = torch.zeros(len(self.shrink), x.shape[1])
        along.index_add_(0, self.point, self.unit * x)
        return x - self.unit * (self.shrink * along)[self.point]

    def __call__(self, x: torch.Tensor) -> torch.Tensor:
        return self.without(x * self.scale)

    def transposed(self, x: torch.Tensor) -> torch.Tensor:
        return self.without(x) * self.scale

    def of_sum(
        self, mixed: Mixed, color: np.ndarray, bounds: np.ndarray, out: torch.Tensor
    ) -> None:
        """The whitened rows color U + W of the matrices `mixed`, color (n,), written to `out` (n,
        M).
        """
        scale, unit, shrink = (x[:, 0].numpy() for x in (self.scale, self.unit, self.shrink))
        U, W, color = mixed.U.numpy(), mixed.W.numpy(), color.astype(np.float32)
        whitened_into(U, W, color, scale, unit, shrink, bounds, out.numpy())


def whiteners(
    model: RowModel, U: np.ndarray, W: np.ndarray, materials: RegionMaterials
) -> list[Whitener]:
    """A Whitener per channel, where U and W (n, 3) are what the lobes see.

    (I - shrink u u') D^-1/2 whitens D + v U U'.
    """
    data = model.data
    v = model.variance(materials)
    weight = (data.point_weight / model.noise.design_effect)[data.rows.point, None]
    scale = np.sqrt(model.counted(U, W, materials) * weight)
    u = scale * U
    norm = np.maximum(data.per_point(u * u), 1e-30)
    shrink = 1 - 1 / np.sqrt(1 + v * norm)
    unit = u / np.sqrt(norm)[data.rows.point]

    point = torch.from_numpy(data.rows.point)
    column = lambda x, c: torch.from_numpy(x[:, c].astype(np.float32))[:, None]
    return [Whitener(column(scale, c), column(unit, c), column(shrink, c), point) for c in range(3)]


@dataclass(frozen=True)
class RowLikelihood:
    """Log-likelihood of the rows given the light, at given materials, offsets (3, p) and noise."""

    data: RowData
    noise: Noise
    materials: RegionMaterials
    offsets: np.ndarray
    matrices: Mixed

    @classmethod
    def at(
        cls, mixer: Mixer, noise: Noise, materials: RegionMaterials, offsets: np.ndarray
    ) -> RowLikelihood:
        """The likelihood at these materials and errors."""
        matrices = mixer(*point_lobes(mixer.data, materials, offsets))
        return cls(mixer.data, noise, materials, offsets, matrices)

    @classmethod
    def of(cls, mixer: Mixer, state: State) -> RowLikelihood:
        """The likelihood at a state's materials and errors."""
        return cls.at(mixer, state.noise, state.materials, state.offsets)

    def recolored(self, color: np.ndarray) -> RowLikelihood:
        """The same at other mean base colours (R, 3)."""
        return replace(self, materials=replace(self.materials, color=color))

    @cached_property
    def model(self) -> RowModel:
        """The rows' probability given what the lobes see."""
        return RowModel(self.data, self.noise)

    def albedo(self) -> np.ndarray:
        """Albedo (p, 3) of the points for light between parts of the object, all lobes together."""
        roughness, metallic = point_lobes(self.data, self.materials, self.offsets)
        U, W = mix(self.data.lobes.albedo[roughness].T[..., None], metallic[:, None])
        return np.clip(self.materials.color[self.data.region] * U + W, 0, ALBEDO_MAX)

    def irradiance(self, light: np.ndarray) -> np.ndarray:
        """Of the surface's nodes (q, 3) by a light and the ground; by the ground alone where light
        between parts of the object is left out.
        """
        transport = self.data.transport
        return transport.irradiance(light) if self.data.bounces > 1 else transport.ground_light

    def nodes(self, irradiance: np.ndarray) -> np.ndarray:
        """Radiance (q, 3) that the nodes give off under `irradiance` (q, 3), and the ground's
        columns (`Transport.with_ground`).
        """
        transport, reflections = self.data.transport, self.data.bounces - 1
        if not reflections:
            return transport.with_ground(np.zeros_like(irradiance))
        return transport.with_ground(transport.exitant(irradiance, self.albedo(), reflections))

    def lit(self, light: np.ndarray) -> LitRows:
        """The rows under a light."""
        m = self.matrices
        U, W = lit_by(light, m.U.numpy()), lit_by(light, m.W.numpy())
        of_ground = self.data.transport.ground_light
        return LitRows(self, U, W, self.irradiance(light) - of_ground, of_ground)

    def under(self, light: np.ndarray) -> RowsUnder:
        """The rows and what they see of a light."""
        return RowsUnder(self, light)

    def predict(self, light: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """U and W applied to a light, (n, 3) each, light off the object included."""
        return self.under(light).seen

    def draw_colors(
        self, light: np.ndarray, rng: np.random.Generator
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """What the lobes see of a light, U and W (n, 3), and a draw of the points' colours (p, 3)
        given that.
        """
        U, W = self.predict(light)
        return U, W, self.model.draw_colors(U, W, self.materials, rng)


@dataclass(frozen=True)
class RowsUnder:
    """Rows about a light (M, 3): what several questions about it share is worked out once."""

    rows: RowLikelihood
    light: np.ndarray

    @cached_property
    def seen(self) -> tuple[np.ndarray, np.ndarray]:
        """What the lobes see, U and W (n, 3)."""
        return self.rows.lit(self.light).seen(self.rows.materials.color, np.ones(3))

    @cached_property
    def whiteners(self) -> list[Whitener]:
        """Of every channel."""
        return whiteners(self.rows.model, *self.seen, self.rows.materials)

    @property
    def row_color(self) -> np.ndarray:
        """Mean base colour (n, 3) of every row's region."""
        return self.rows.materials.color[self.rows.data.row_region]

    @property
    def seen_light(self) -> SeenLight:
        """The pixels of the light that photos show."""
        return self.rows.data.seen_light

    def value(self) -> float:
        """Log-likelihood of the light, by what it does to the object and by what is seen of it."""
        of_rows = self.rows.model.point_values(*self.seen, self.rows.materials)
        return float(of_rows.sum()) + self.seen_light.value(self.light)

    @cached_property
    def residual(self) -> torch.Tensor:
        """r (3, n + s) of `expansion`, without building T."""
        rest = self.rows.model.rest(*self.seen, self.rows.materials).astype(np.float32)
        by_channel = zip(self.whiteners, torch.from_numpy(rest).split(1, 1))
        of_rows = torch.stack([whiten(column)[:, 0] for whiten, column in by_channel])
        if not len(self.seen_light.pixel):
            return of_rows
        seen = torch.from_numpy(self.seen_light.residual(self.light).T.astype(np.float32))
        return torch.cat([of_rows, seen], 1)

    def adjoint(self, w: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """T^T w (3, M) and V^T w (3, R) of `expansion` for w (3, n + s), without building T."""
        (U, _), mu, seen = self.seen, self.row_color, self.seen_light
        matrices, data = self.rows.matrices, self.rows.data
        w, of_seen = w[:, : len(U)], w[:, len(U) :].numpy()
        by_channel = enumerate(self.whiteners)
        t = np.stack([whiten.transposed(w[c][:, None])[:, 0].numpy() for c, whiten in by_channel])
        T = (t * mu.T.astype(np.float32)) @ matrices.U.numpy() + t @ matrices.W.numpy()
        T[:, seen.pixel] += of_seen * seen.counted(self.light).T.astype(np.float32)
        regions = len(self.rows.materials)
        weighted = (t[c] * mu[:, c] * U[:, c] for c in range(3))
        V = np.stack([np.bincount(data.row_region, column, regions) for column in weighted])
        return torch.from_numpy(T), torch.from_numpy(V.astype(np.float32))

    def expansion(self) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """T (3, n + s, M), r (3, n + s), V (3, n + s, R): log-likelihood ~ -|r - T dL - V d|^2 / 2
        for a change dL of the light and regions whose log mean colour moves by d; the last s rows
        are those of the light that is seen.

        T is the direct part of the transport, and the bounds of base colours are left out.
        """
        (U, _), mu, data = self.seen, self.row_color, self.rows.data
        matrices, seen = self.rows.matrices, self.seen_light
        rows = len(U)
        T = torch.empty(3, rows + len(seen.pixel), len(self.light))
        V = torch.zeros(3, len(T[0]), len(self.rows.materials))
        for c, whiten in enumerate(self.whiteners):
            whiten.of_sum(matrices, mu[:, c], data.bounds, T[c, :rows])
            by_region = torch.zeros(rows, V.shape[2])
            of_rows = torch.from_numpy((mu[:, c] * U[:, c]).astype(np.float32))
            by_region[np.arange(rows), data.row_region] = of_rows
            V[c, :rows] = whiten(by_region)
        if len(seen.pixel):
            T[:, rows:] = seen.rows(self.light)
        return T, self.residual, V


@dataclass(frozen=True)
class LitRows:
    """Rows under a light, of which the gain of every channel and the mean base colours may change.

    U, W (n, 3): what the lobes see of the light itself; of_light, of_ground (q, 3): irradiance of
    the nodes.
    """

    rows: RowLikelihood
    U: np.ndarray
    W: np.ndarray
    of_light: np.ndarray
    of_ground: np.ndarray

    def seen(self, color: np.ndarray, gain: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """U and W (n, 3) of the light times `gain` (3,) at mean base colours (R, 3), light off the
        object included: of this, darker colours take away what a brighter light adds.

        Metal gives the others what it did with its colour of before. It is no diffuse emitter: how
        its part changes would tell of a light that is too bright.
        """
        held = self.rows.materials
        diffuse = held.metallic[:, None] == 0
        others = self.rows.recolored(np.where(diffuse, color, held.color))
        B = others.nodes(self.of_light * gain + self.of_ground)
        m = self.rows.matrices
        return self.U * gain + m.off_U @ B, self.W * gain + m.off_W @ B
