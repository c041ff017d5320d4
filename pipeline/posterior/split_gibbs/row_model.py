"""Probability of the photos' rows given what the lobes see, with base colours integrated out.

Rows i of surface point p in region r, per channel:

    y_i = a_p U_i + W_i + e_i              what the lobes see of the light (lobes.py)
    a_p ~ N(mu_r, tau_r^2 mu_r^2) on [0, ALBEDO_MAX]
    e_i ~ N(0, eta^2 (y_i + SHADE)^2 / lambda_i),    lambda_i ~ Gamma(NU / 2, NU / 2)

A point's base colour varies about its region's mean, is positive and stays below ALBEDO_MAX; errors
are Student's t, so that outliers count less. With v = tau^2 mu^2 and D the errors' variances the
rows of a point are y_p ~ N(mu U + W, D + v U U'), in closed form by the rank-one identities, times
the probability that a_p is possible given y_p over that of a_p > 0 without the photos: a light too
dim for the brightest points is no explanation. The bound holds for mean and points together:
p(mu, a) ~ p(mu) N(a; mu, v) below it. With a normal distribution cut off for every mu by itself,
colours that nature keeps within bounds, as it does, would be explained best by a light so dim that
their bound is ALBEDO_MAX. A region of one colour tells of the light by its shading, a busy texture
does not, and the data decide which it is.

Neighbouring rows err together (a wrong normal, a wrong camera): the log-likelihood is divided by
the design effect kappa, measured from residuals (noise.py), and every point has a weight of its own
in a draw. A saturated row is a lower bound: it counts, at the clip level, only while predicted
darker than that with the colour that the point's other rows give it. (Drawing what it would have
shown instead creeps: docs/experiments.md.)
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import special

from pipeline.posterior.problem import ALBEDO_MAX, SHADE
from pipeline.posterior.seen_light import SeenLight
from pipeline.posterior.split_gibbs.coherence import Neighbours
from pipeline.posterior.split_gibbs.lobes import LobeTable
from pipeline.posterior.split_gibbs.row_loops import sums_by_point
from pipeline.posterior.split_gibbs.state import Noise, RegionMaterials
from pipeline.render.rows import Rows
from pipeline.render.surroundings import Sightings
from pipeline.render.transport import Transport


@dataclass(frozen=True)
class RowData:
    """What a draw is made from, and does not change in it.

    observed (n, 3): radiance of the rows; clipped (n, 3): whether that is a lower bound;
    region (p,): of every point; point_weight (p,): how much its rows count in this draw;
    light_rows: rows of the light that the operator resolves; bounces: how many surface interactions
    light has behind it at most, as the path tracer's; neighbours: which points of a region prefer
    to be alike; sightings: what photos show of the light itself; told (n,): whether a row counts,
    or is kept to judge by (`thinning.explained`).
    """

    transport: Transport
    lobes: LobeTable
    rows: Rows
    observed: np.ndarray
    clipped: np.ndarray
    region: np.ndarray
    point_weight: np.ndarray
    light_rows: int
    bounces: int
    neighbours: Neighbours
    told: np.ndarray
    sightings: Sightings | None = None

    @classmethod
    def plain(
        cls,
        transport: Transport,
        lobes: LobeTable,
        observed: np.ndarray,
        region: np.ndarray,
        bounces: int,
    ) -> RowData:
        """Rows of `transport`, none of them saturated, all points of one weight and by
        themselves.
        """
        points = len(region)
        return cls(
            transport=transport,
            lobes=lobes,
            rows=transport.rows,
            observed=observed.astype(np.float64),
            clipped=np.zeros(observed.shape, bool),
            region=region,
            point_weight=np.ones(points),
            light_rows=transport.h,
            bounces=bounces,
            neighbours=Neighbours.none(points),
            told=np.ones(len(observed), bool),
        )

    @cached_property
    def seen_light(self) -> SeenLight:
        """The pixels of the operator's light that photos show."""
        return SeenLight.of(self.sightings, self.light_rows)

    @property
    def unbounded(self) -> np.ndarray:
        """Values that count and are no lower bounds (n, 3)."""
        return ~self.clipped & self.told[:, None]

    @cached_property
    def starts(self) -> np.ndarray:
        """First row of each point (p,)."""
        return self.rows.starts

    @cached_property
    def bounds(self) -> np.ndarray:
        """Where the rows of each point begin, and the last one's end (p + 1,)."""
        return np.append(self.starts, len(self.observed))

    @cached_property
    def row_region(self) -> np.ndarray:
        """Region of every row (n,)."""
        return self.region[self.rows.point]

    def per_point(self, rows: np.ndarray) -> np.ndarray:
        """Sums (p, 3) over each point's rows (n, 3)."""
        return np.add.reduceat(rows, self.starts, axis=0)


@dataclass(frozen=True)
class RowModel:
    """Rows and their errors; U and W (n, 3) are always what the lobes see of the light."""

    data: RowData
    noise: Noise

    def row_by_row(self) -> RowModel:
        """Every row counts in full: for the noise and the spread of colours, whose estimates
        correlation does not bias.

        Thinned rows would explain texture away as noise. (Composite likelihood: nuisance parameters
        by the plain one.)
        """
        even = np.ones(len(self.data.region))
        return RowModel(
            replace(self.data, point_weight=even), replace(self.noise, design_effect=1.0)
        )

    @cached_property
    def precision(self) -> np.ndarray:
        """1 / variance of each row and channel (n, 3), whether it counts or not."""
        weight = self.noise.weight * self.data.told
        return weight[:, None] / (self.noise.scale * (self.data.observed + SHADE)) ** 2

    def counted(self, U: np.ndarray, W: np.ndarray, materials: RegionMaterials) -> np.ndarray:
        """`precision` (n, 3) without the saturated values that U and W explain."""
        clipped = self.data.clipped
        if not clipped.any():
            return self.precision

        precision = self.precision.copy()
        lower = precision[clipped]
        precision[clipped] = 0
        sums = self.sums(U, self.rest(U, W, materials), precision)
        color = self.colors(*sums, materials)[0][self.data.rows.point]
        darker = (color * U + W < self.data.observed)[clipped]
        precision[clipped] = np.where(darker, lower, 0)
        return precision

    def variance(self, materials: RegionMaterials) -> np.ndarray:
        """v: variance of the points' base colours about their region's mean, (p, 3)."""
        return ((materials.spread[:, None] * materials.color) ** 2)[self.data.region]

    def colors(
        self, q: np.ndarray, g: np.ndarray, materials: RegionMaterials
    ) -> tuple[np.ndarray, np.ndarray]:
        """Mean and variance (p, 3) of the points' base colours given their rows, from `sums`; the
        mean may lie outside what is possible.
        """
        mu = materials.color[self.data.region]
        v = np.maximum(self.variance(materials), 1e-10)
        return mu + v * g / (1 + v * q), v / (1 + v * q)

    def rest(self, U: np.ndarray, W: np.ndarray, materials: RegionMaterials) -> np.ndarray:
        """What the regions' mean colours leave over, y - mu U - W, (n, 3)."""
        return self.data.observed - materials.color[self.data.row_region] * U - W

    def sums(
        self,
        U: np.ndarray,
        rest: np.ndarray,
        precision: np.ndarray,
        point_weight: float | None = None,
    ) -> tuple[np.ndarray, np.ndarray]:
        """q and g (p, 3): per point and channel sum w U^2 and sum w U r over kappa, with w the
        precision and r the rest, times the point's weight.
        """
        wU = precision * U
        return self.thinned(wU * U, point_weight), self.thinned(wU * rest, point_weight)

    def thinned(self, rows: np.ndarray, point_weight: float | None = None) -> np.ndarray:
        """Sums (p, 3) over each point's rows (n, 3), over kappa and times the point's weight."""
        weight = self.data.point_weight if point_weight is None else point_weight
        return self.data.per_point(rows) * np.reshape(weight / self.noise.design_effect, (-1, 1))

    def point_values(self, U: np.ndarray, W: np.ndarray, materials: RegionMaterials) -> np.ndarray:
        """Log-likelihood of every point (p,), constants of the noise left out.

        Saturated rows always count in the determinant, so that none gains by falling silent.
        """
        data, v = self.data, self.variance(materials)
        weight = data.point_weight / self.noise.design_effect
        mu = materials.color[data.region]
        q, g, s, all_q = sums_by_point(
            U, W, data.observed, data.clipped, self.precision, mu, v, weight, data.bounds
        )

        possible = log_possible(*self.colors(q, g, materials))
        positive = special.log_ndtr(1 / materials.spread)[data.region, None]
        fit = -0.5 * (s - v * g * g / (1 + v * q))
        return (fit - 0.5 * np.log1p(v * all_q) + possible - positive).sum(1)

    def draw_colors(
        self, U: np.ndarray, W: np.ndarray, materials: RegionMaterials, rng: np.random.Generator
    ) -> np.ndarray:
        """Base colour of every point (p, 3) given everything else, within [0, ALBEDO_MAX]."""
        precision = self.counted(U, W, materials)
        sums = self.sums(U, self.rest(U, W, materials), precision, 1.0)
        mean, variance = self.colors(*sums, materials)
        deviation = np.sqrt(variance)
        low, high = (special.ndtr((edge - mean) / deviation) for edge in (0.0, ALBEDO_MAX))
        drawn = np.clip(low + rng.random(low.shape) * (high - low), 1e-9, 1 - 1e-9)
        return np.clip(mean + deviation * special.ndtri(drawn), 0.0, ALBEDO_MAX)

    def misfit(
        self, U: np.ndarray, W: np.ndarray, colors: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Squared relative residuals (n, 3) given the points' colours (p, 3), and where a value is
        explained, so that it is 0 (n, 3): a saturated one, or one that does not count.
        """
        observed = self.data.observed
        predicted = colors[self.data.rows.point] * U + W
        explained = self.data.clipped & (predicted >= observed) | ~self.data.told[:, None]
        relative = ((observed - predicted) / (observed + SHADE)) ** 2
        return np.where(explained, 0, relative), explained


def log_possible(mean: np.ndarray, variance: np.ndarray) -> np.ndarray:
    """Log-probability that normal base colours lie in [0, ALBEDO_MAX], accurate far outside too."""
    deviation = np.sqrt(np.maximum(variance, 1e-10))
    low = -mean / deviation
    high = (ALBEDO_MAX - mean) / deviation
    # log_ndtr is accurate below 0: mirror the interval where it lies above
    low, high = np.where(low > 0, -high, low), np.where(low > 0, -low, high)
    upper = special.log_ndtr(high)
    return upper + np.log1p(-np.exp(special.log_ndtr(low) - upper))
