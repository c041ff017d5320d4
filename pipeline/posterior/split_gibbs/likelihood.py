"""Likelihood of the photos' rows given light and region materials, with the base colour of every
point integrated out.

Rows i of surface point p in region r, per channel (see transport.py for the lobes):

    y_i = a_p U_i + W_i + e_i,   U = (1 - m) A + m (M1 - M0),   W = (1 - m) S + m M0   (each applied
    to the light) a_p ~ N(mu_r, tau_r^2 mu_r^2) on [0, c_p]           base colour varies about its
    region's mean, below the point's ceiling e_i ~ N(0, eta^2 (y_i + SHADE)^2 / lambda_i)
    lambda_i ~ Gamma(NU / 2, NU / 2): Student's t, outliers count less

so y_p ~ N(mu U + W, D + v U U') with v = tau^2 mu^2, in closed form by the rank-one identities,
times the share of a_p given y_p that is possible over the share of a_p that is: a light too dim for
the brightest points is no explanation. Rows are means over patches, whose brightest pixels reach
ALBEDO_MAX when the mean is at c_p (`contrast`). A region of one colour tells of the light by its
shading, a busy texture does not, and the data decide which it is. (The linearisations leave the
bounds out.)

Neighbouring rows err together (a wrong normal, a wrong camera): the log-likelihood is divided by
the design effect kappa, measured from residuals. A saturated row is a lower bound: it counts, at
the clip level, only while it is predicted darker than that with the colour that the point's other
rows give it. (Drawing what it would have shown, light given that and that given light, creeps: the
highlights' peaks never got above the clip level by more than the noise in a turn.)
"""

from __future__ import annotations

from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
import torch
from scipy import sparse, special, stats
from scipy.spatial import cKDTree

from pipeline.posterior.problem import ALBEDO_MAX, SHADE
from pipeline.render.principled_lobes import lobe_albedo
from pipeline.render.rows import Rows
from pipeline.render.transport import Transport

NU = 4.0  # degrees of freedom of the residuals
LEVELS = (0.08, 0.15, 0.25, 0.35, 0.5, 0.65, 0.8, 1.0)  # roughness of the lobes that are traced
BETWEEN = 4  # steps of roughness from one of them to the next, its lobes by interpolation
# share of the light that a lobe may lose by what its facets reflect twice, which it leaves out
SWALLOWED = 0.3
BRIGHT = 0.9  # quantile of a point's pixels whose base colour must be possible
METALLIC = np.array([0.0, 0.02, 0.05, 0.1, 0.2, 0.35, 0.5, 0.65, 0.8, 0.9, 0.95, 0.98, 1.0])


def metallic_step(m: np.ndarray) -> np.ndarray:
    """Index (R,) in METALLIC nearest to m (R,)."""
    return np.abs(m[:, None] - METALLIC).argmin(1)


@dataclass
class Theta:
    """Region materials: mean base colour mu (R, 3), its relative spread tau (R,), roughness level
    (R,), metallic m (R,).
    """

    mu: np.ndarray
    tau: np.ndarray
    level: np.ndarray
    m: np.ndarray

    def copy(self) -> Theta:
        return Theta(*(v.copy() for v in vars(self).values()))

    @classmethod
    def joined(cls, parts: list[Theta]) -> Theta:
        """Inverse of `of` region by region."""
        return cls(*(np.concatenate([getattr(p, name) for p in parts]) for name in vars(parts[0])))

    def of(self, regions: list[int]) -> Theta:
        """Some regions' part."""
        return Theta(*(v[regions] for v in vars(self).values()))

    def made_of(self, level: int, metallic: float) -> Theta:
        """The same colours in another material."""
        return Theta(
            self.mu.copy(),
            self.tau.copy(),
            np.full_like(self.level, level),
            np.full_like(self.m, metallic),
        )


class Lobes:
    """The lobes' light matrices (4, n, M) at every one of LEVELS from roughness_min on, and the
    sparse ones for light off the object.

    `levels` has BETWEEN steps of log roughness from each to the next, where lobes are interpolated:
    halfway between, that is as near to the traced lobe as two traced ones are to each other (2 to 6
    %; the nearer neighbour: 7 to 22 %). A gloss tells how bright the light is by how broad it is;
    with the traced levels alone it would be sure of a wrong brightness.

    `most_metallic` (levels,) of METALLIC goes down where the lobe of a white metal loses light:
    from `swallowed` on it is no metal there is (Heitz et al. 2016), yet makes a good dark wool.
    """

    def __init__(
        self, transport: Transport, roughness_min: float, seed: int, swallowed: float = SWALLOWED
    ):
        traced = [r for r in LEVELS if r >= roughness_min]
        self.direct, self.off = [], []
        for k, r in enumerate(traced):
            F, G = transport.at(r, seed * 101 + k)
            self.direct.append(torch.from_numpy(F))
            self.off.append(G)
        steps = np.arange(BETWEEN * (len(traced) - 1) + 1) / BETWEEN
        self.levels = tuple(
            np.exp(np.interp(steps, np.arange(len(traced)), np.log(traced))).round(3).tolist()
        )
        self.albedo = self.between(np.stack([lobe_albedo(r) for r in traced]))  # (levels, 4)
        self.most_metallic = np.array(
            [METALLIC[METALLIC * (1 - white) <= swallowed].max() for _, _, white, _ in self.albedo]
        )

    @staticmethod
    def between(values: np.ndarray) -> np.ndarray:
        """Values of every level (levels, ...), those of the traced ones (k, ...) being given."""
        level = np.arange(BETWEEN * (len(values) - 1) + 1)
        low, high, share = neighbours(level, len(values))
        share = share.astype(values.dtype).reshape((-1,) + (1,) * (values.ndim - 1))
        return (1 - share) * values[low] + share * values[high]

    def at(self, level: int, rows=slice(None)) -> torch.Tensor:
        """Light matrices (4, n, M) of some rows at one level."""
        low, high, share = neighbours(level, len(self.direct))
        return (
            self.direct[low][:, rows]
            if share == 0
            else torch.lerp(self.direct[low][:, rows], self.direct[high][:, rows], float(share))
        )

    def apply(self, light: np.ndarray, nodes: np.ndarray) -> np.ndarray:
        """(levels, 4, n, 3): every lobe at every level under light (M, 3), exitant radiance of the
        nodes (q, 3).
        """
        L = light.astype(np.float32)
        return self.between(
            np.stack(
                [
                    F.numpy() @ L + np.stack([g @ nodes for g in G])
                    for F, G in zip(self.direct, self.off)
                ]
            )
        )


def neighbours(level, traced: int):
    """The two of the `traced` lobes between which a level lies, and its way from the first to the
    second.
    """
    return level // BETWEEN, np.minimum(level // BETWEEN + 1, traced - 1), level % BETWEEN / BETWEEN


def mix(parts, m):
    """U and W from the four lobes (4, ...) at metallic m."""
    return (1 - m) * parts[0] + m * (parts[2] - parts[3]), (1 - m) * parts[1] + m * parts[3]


@dataclass
class Whitener:
    """(I - shrink u u') diag(scale) point by point: scale (n, 1), unit vectors u (n, 1), shrink (p,
    1), point of every row (n,).
    """

    scale: torch.Tensor
    unit: torch.Tensor
    shrink: torch.Tensor
    point: torch.Tensor

    def without(self, x: torch.Tensor) -> torch.Tensor:
        along = torch.zeros(len(self.shrink), x.shape[1]).index_add_(0, self.point, self.unit * x)
        return x - self.unit * (self.shrink * along)[self.point]

    def __call__(self, x: torch.Tensor) -> torch.Tensor:
        return self.without(x * self.scale)

    def transposed(self, x: torch.Tensor) -> torch.Tensor:
        return self.without(x) * self.scale


class Photos:
    """Rows of the photos with their noise, and what the current materials make of them.

    observed (n, 3), clipped (n,): whether that is a lower bound; region (p,) of every point;
    ceiling (p, 3) of their base colours. `light` arguments are (M, 3) radiance.
    """

    def __init__(
        self,
        transport: Transport,
        lobes: Lobes,
        rgb: np.ndarray,
        clipped: np.ndarray,
        region: np.ndarray,
        bounces: int,
        rows: Rows | None = None,
    ):
        self.transport, self.lobes, self.rows, self.bounces = (
            transport,
            lobes,
            rows or transport.rows,
            bounces,
        )
        self.observed, self.clipped = rgb.astype(np.float64), clipped
        self.region, self.starts = region, self.rows.starts
        self.row_region = region[self.rows.point]
        self.eta, self.kappa, self.weight, self.share = (
            0.3,
            1.0,
            np.ones(len(rgb)),
            np.ones(len(region)),
        )
        self.ceiling = np.full((len(region), 3), ALBEDO_MAX)
        self.offset = np.zeros(
            (2, len(region)), int
        )  # of every point's roughness level and step of metallic from its region's
        self.theta: Theta | None = None
        self.assembled = None  # (level, m) per point of the matrices U, W

    @contextmanager
    def row_by_row(self):
        """Every row counts in full: for the noise and the spread of colours, whose estimates
        correlation does not bias.

        Thinned rows would explain texture away as noise. (Composite likelihood: nuisance parameters
        by the plain one.)
        """
        kept, self.kappa, self.share = (self.kappa, self.share), 1.0, np.ones(len(self.region))
        yield
        self.kappa, self.share = kept

    @property
    def precision(self) -> np.ndarray:
        """1 / variance of each row and channel (n, 3), whether it counts or not."""
        return self.weight[:, None] / (self.eta * (self.observed + SHADE)) ** 2

    def counted(self, U: np.ndarray, W: np.ndarray, theta: Theta) -> np.ndarray:
        """`precision` (n, 3) without the saturated rows that U and W (n, 3) explain."""
        precision, k = self.precision, self.clipped
        if k.any():
            lower = precision[k]
            precision[k] = 0
            colour = self.colours(*self.sums(U, self.rest(U, W, theta), precision), theta)[0][
                self.rows.point[k]
            ]
            precision[k] = np.where(colour * U[k] + W[k] < self.observed[k], lower, 0)
        return precision

    def colours(self, q: np.ndarray, g: np.ndarray, theta: Theta) -> tuple[np.ndarray, np.ndarray]:
        """Mean and variance (p, 3) of the points' base colours, from `sums`; the mean may lie
        outside what is possible.
        """
        mu = theta.mu[self.region]
        v = np.maximum(self.variance(theta), 1e-10)
        return mu + v * g / (1 + v * q), v / (1 + v * q)

    def variance(self, theta: Theta) -> np.ndarray:
        """Of the points' base colours about their region's mean, (p, 3)."""
        return ((theta.tau[:, None] * theta.mu) ** 2)[self.region]

    def point_materials(self, theta: Theta) -> tuple[np.ndarray, np.ndarray]:
        """Roughness level and metallic of every point, (p,) each; as metallic as can be, where
        offsets lead beyond.
        """
        level = np.clip(theta.level[self.region] + self.offset[0], 0, len(self.lobes.levels) - 1)
        m = METALLIC[
            np.clip(metallic_step(theta.m)[self.region] + self.offset[1], 0, len(METALLIC) - 1)
        ]
        return level, np.minimum(m, self.lobes.most_metallic[level])

    def set(self, theta: Theta) -> None:
        """Materials that `predict`, `value` and `whitened` use. Matrices are rebuilt only where
        they changed.
        """
        level, m = self.point_materials(theta)
        key = (level.tobytes(), m.tobytes())
        if key != self.assembled:
            n, M = self.lobes.direct[0].shape[1:]
            self.U, self.W = torch.empty(n, M), torch.empty(n, M)
            self.off = [sparse.csr_matrix(self.lobes.off[0][0].shape)] * 2
            level, m = level[self.rows.point], m[self.rows.point]
            for k in np.unique(level):
                index = torch.from_numpy(np.flatnonzero(level == k))
                self.U[index], self.W[index] = mix(
                    self.lobes.at(k, index),
                    torch.from_numpy(m[level == k].astype(np.float32))[:, None],
                )
            low, high, way = neighbours(level, len(self.lobes.off))
            for k in np.union1d(low, high[way > 0]):
                share = np.where(low == k, 1 - way, 0) + np.where(high == k, way, 0)
                black, white = (sparse.diags(share * part) for part in (1 - m, m))
                a, s, m1, m0 = self.lobes.off[k]
                self.off = [
                    self.off[0] + black @ a + white @ (m1 - m0),
                    self.off[1] + black @ s + white @ m0,
                ]
            self.assembled = key
        self.theta = theta

    def albedo(self, theta: Theta) -> np.ndarray:
        """Albedo (p, 3) of the points for light between parts of the object, all lobes together."""
        level, m = self.point_materials(theta)
        U, W = mix(self.lobes.albedo[level].T[..., None], m[:, None])
        return np.clip(theta.mu[self.region] * U + W, 0, ALBEDO_MAX)

    def nodes(self, light: np.ndarray, theta: Theta) -> np.ndarray:
        return (
            self.transport.exitant(light, self.albedo(theta), self.bounces - 1)
            if self.bounces > 1
            else np.zeros((len(self.transport.node_position), 3))
        )

    def predict(self, light: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """U and W applied to the light, (n, 3) each, light off the object included."""
        L, (off_U, off_W) = light.astype(np.float32), self.off_object(light)
        return (
            self.U.numpy() @ L + off_U,
            self.W.numpy() @ L + off_W,
        )  # numpy: 3 times faster than torch on so few columns

    def off_object(self, light: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The part of `predict` that comes off the object."""
        B = self.nodes(light, self.theta)
        return self.off[0] @ B, self.off[1] @ B

    def per_point(self, rows: np.ndarray) -> np.ndarray:
        """Sums (p, 3) over each point's rows (n, 3)."""
        return np.add.reduceat(rows, self.starts, axis=0)

    def rest(self, U, W, theta: Theta) -> np.ndarray:
        """What the regions' mean colours leave over, y - mu U - W, (n, 3)."""
        return self.observed - theta.mu[self.row_region] * U - W

    def sums(
        self, U, rest: np.ndarray, precision: np.ndarray, share=None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Per point and channel: sum w U^2 and sum w U r over kappa, with w `precision` and r the
        `rest`; (p, 3) each.
        """
        wU, share = precision * U, self.share if share is None else share
        return self.thinned(wU * U, share), self.thinned(wU * rest, share)

    def thinned(self, rows: np.ndarray, share) -> np.ndarray:
        """`per_point` of rows (n, 3), over kappa and with the points' shares."""
        return self.per_point(rows) * np.reshape(share / self.kappa, (-1, 1))

    def point_values(self, U: np.ndarray, W: np.ndarray, theta: Theta) -> np.ndarray:
        """Log-likelihood of every point (p,), constants of the noise left out. Saturated rows
        always count in the determinant, so that none gains by falling silent.
        """
        v = self.variance(theta)
        precision, rest = self.counted(U, W, theta), self.rest(U, W, theta)
        (q, g), s = self.sums(U, rest, precision), self.thinned(precision * rest**2, self.share)
        all_q = self.thinned(self.precision * U * U, self.share) if self.clipped.any() else q
        possible = log_possible(*self.colours(q, g, theta), self.ceiling) - log_possible(
            theta.mu[self.region], v, self.ceiling
        )
        return (-0.5 * (s - v * g * g / (1 + v * q)) - 0.5 * np.log1p(v * all_q) + possible).sum(1)

    def value(self, light: np.ndarray) -> float:
        return float(self.point_values(*self.predict(light), self.theta).sum())

    def whiteners(self, U: np.ndarray, W: np.ndarray) -> list[Whitener]:
        """What makes each channel's rows independent with deviation 1, where U and W (n, 3) are
        `predict`'s.
        """
        v = self.variance(self.theta)
        scale = np.sqrt(
            self.counted(U, W, self.theta) * (self.share / self.kappa)[self.rows.point, None]
        )
        u = scale * U
        norm = np.maximum(self.per_point(u * u), 1e-30)
        shrink = 1 - 1 / np.sqrt(1 + v * norm)  # (I - shrink uu') D^-1/2 whitens D + v UU'
        unit, point = u / np.sqrt(norm)[self.rows.point], torch.from_numpy(self.rows.point)
        column = lambda x, c: torch.from_numpy(x[:, c].astype(np.float32))[:, None]
        return [
            Whitener(column(scale, c), column(unit, c), column(shrink, c), point) for c in range(3)
        ]

    def residual(self, light: np.ndarray) -> torch.Tensor:
        """r (3, n) of `whitened`, without building T."""
        U, W = self.predict(light)
        rest = torch.from_numpy(self.rest(U, W, self.theta).astype(np.float32))
        return torch.stack(
            [whiten(rest[:, c : c + 1])[:, 0] for c, whiten in enumerate(self.whiteners(U, W))]
        )

    def adjoint(self, light: np.ndarray, w: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """T^T w (3, M) and V^T w (3, R) of `whitened` for w (3, n), without building T."""
        U, W = self.predict(light)
        mu = self.theta.mu[self.row_region]
        t = np.stack(
            [
                whiten.transposed(w[c][:, None])[:, 0].numpy()
                for c, whiten in enumerate(self.whiteners(U, W))
            ]
        )
        T = (t * mu.T.astype(np.float32)) @ self.U.numpy() + t @ self.W.numpy()
        V = np.stack(
            [
                np.bincount(self.row_region, t[c] * mu[:, c] * U[:, c], len(self.theta.m))
                for c in range(3)
            ]
        )
        return torch.from_numpy(T), torch.from_numpy(V.astype(np.float32))

    def whitened(self, light: np.ndarray) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """T (3, n, M), r (3, n), V (3, n, R): log-likelihood ~ -|r - T dL - V d|^2 / 2 for a change
        dL of `light` and regions whose log mean colour moves by d; T is the direct part of the
        transport.
        """
        (U, W), mu = self.predict(light), self.theta.mu[self.row_region]
        rest = self.rest(U, W, self.theta)
        column = lambda x: torch.from_numpy(x.astype(np.float32))[:, None]
        T, r, V = (
            torch.empty((3,) + self.U.shape),
            torch.empty(3, len(mu)),
            torch.zeros(3, len(mu), len(self.theta.m)),
        )
        for c, whiten in enumerate(self.whiteners(U, W)):
            T[c] = whiten(column(mu[:, c]) * self.U + self.W)
            r[c] = whiten(column(rest[:, c]))[:, 0]
            V[c][np.arange(len(mu)), self.row_region] = torch.from_numpy(
                (mu[:, c] * U[:, c]).astype(np.float32)
            )
            V[c] = whiten(V[c])
        return T, r, V

    def draw_colour(self, U, W, theta: Theta, rng) -> np.ndarray:
        """Base colour of every point (p, 3) given everything else, within [0, ceiling]."""
        mean, variance = self.colours(
            *self.sums(U, self.rest(U, W, theta), self.counted(U, W, theta), 1.0), theta
        )
        deviation = np.sqrt(variance)
        low, high = (stats.norm.cdf((edge - mean) / deviation) for edge in (0.0, self.ceiling))
        inside = stats.norm.ppf(np.clip(low + rng.random(low.shape) * (high - low), 1e-9, 1 - 1e-9))
        return np.clip(mean + deviation * inside, 0.0, self.ceiling)

    def misfit(self, U, W, colour: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Squared relative residuals (n, 3) given the points' colours (p, 3), and where saturated
        rows are explained, so that it is 0.
        """
        predicted = colour[self.rows.point] * U + W
        free = self.clipped[:, None] & (predicted >= self.observed)
        return np.where(free, 0, ((self.observed - predicted) / (self.observed + SHADE)) ** 2), free

    def log_noise(self, U, W, colour: np.ndarray) -> float:
        """Log-density of all residuals with lambda integrated out, Student's t of scale eta, up to
        a constant; saturated rows as a penalty only.
        """
        relative, free = self.misfit(U, W, colour)
        tail = 0.5 * (NU + (~free).sum(1)) * np.log1p(relative.sum(1) / (NU * self.eta**2))
        return float(-tail.sum() - 3 * (~self.clipped).sum() * np.log(self.eta))

    def draw_noise(self, U, W, colour: np.ndarray, rng) -> None:
        """New eta and lambda, given the points' colours; from rows that are not saturated, for the
        others say little of either.
        """
        relative, free = self.misfit(U, W, colour)
        self.weight = rng.gamma(
            0.5 * (NU + (~free).sum(1)), 1 / (0.5 * (NU + relative.sum(1) / self.eta**2))
        )
        rest = ~self.clipped
        freedom = relative[rest].size / self.kappa
        scale = (self.weight[rest, None] * relative[rest]).sum() / self.kappa
        self.eta = float(np.sqrt((0.5 * scale + 1e-4) / rng.gamma(0.5 * freedom + 1.0)))


def log_possible(mean: np.ndarray, variance: np.ndarray, ceiling: np.ndarray) -> np.ndarray:
    """Log-probability that normal base colours lie in [0, ceiling], accurate far outside too."""
    deviation = np.sqrt(np.maximum(variance, 1e-10))
    low, high = -mean / deviation, (ceiling - mean) / deviation
    low, high = (
        np.where(low > 0, -high, low),
        np.where(low > 0, -low, high),
    )  # log_ndtr is accurate below 0
    upper = special.log_ndtr(high)
    return upper + np.log1p(-np.exp(special.log_ndtr(low) - upper))


def contrast(rows: Rows, rgb: np.ndarray) -> np.ndarray:
    """How much brighter than the mean of their patch the BRIGHT quantile of every point's pixels
    is, (p, 3), at least 1; rgb (observations, 3).
    """
    P, points = rows.patch, len(rows.starts)
    row = np.repeat(np.arange(P.shape[0]), np.diff(P.indptr))
    ratio = rgb[P.indices] / np.maximum((P @ rgb)[row], 1e-6)
    pixels = np.split(
        ratio, np.searchsorted(rows.point[row], np.arange(1, points))
    )  # rows are sorted by point
    return np.maximum([np.quantile(r, BRIGHT, axis=0) for r in pixels], 1.0)


def channel_effect(residual: np.ndarray) -> float:
    """Channels per independent channel, residual (n, 3): a wrong normal or shadow errs in all three
    at once.
    """
    r = residual / np.maximum(residual.std(0), 1e-12)
    r = np.clip(r - r.mean(0), -4, 4)
    return 1 + 2 * float(np.clip((np.corrcoef(r.T).sum() - 3) / 6, 0, 1))


def design_effect(
    rows: Rows, position: np.ndarray, view: np.ndarray, residual: np.ndarray, bins: int = 12
) -> float:
    """Rows per independent row: 1 + sum over other rows of the same view of the residuals'
    correlation at that distance.

    residual (n,) standardised; position (n, 3). Correlations are averaged in distance bins, the
    first one reaching 1.5 times the usual distance of neighbours, and taken as zero from the first
    bin below 0.05 on (Kish 1965 for the name).
    """
    first = position[rows.starts]
    reach = 1.5 * bins * float(np.median(cKDTree(first).query(first, 2)[0][:, 1]))
    top, count, r = (
        np.zeros(bins),
        np.zeros(bins),
        (residual - residual.mean()) / max(residual.std(), 1e-12),
    )
    for k in np.unique(view):
        mine = np.flatnonzero(view == k)
        pairs = cKDTree(position[mine]).query_pairs(reach, output_type="ndarray")
        if len(pairs):
            i, j = mine[pairs.T]
            which = np.minimum(
                (np.linalg.norm(position[i] - position[j], axis=1) / reach * bins).astype(int),
                bins - 1,
            )
            top += np.bincount(which, r[i] * r[j], bins)
            count += np.bincount(which, minlength=bins)
    correlation = np.where(count > 20, top / np.maximum(count, 1), 0)
    end = np.argmax(correlation < 0.05) if (correlation < 0.05).any() else bins
    return float(1 + 2 * (correlation[:end] * count[:end]).sum() / len(residual))
