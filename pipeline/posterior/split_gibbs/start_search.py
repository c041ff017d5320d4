"""A start for the chain: region materials by their evidence, with the light integrated out roughly.

Roughness and light explain each other: moving one while the other is held gets stuck at whatever
the fit had. Here some of the points stand for all, the light has the Gaussian prior's leading modes
only, and region after region draws its roughness and metallic from all candidates, the light and
the region's colour integrated out by Laplace's method for each candidate k:

    log p(y | k) ~ l(c, k) + b' H^-1 b / 2 - log det H / 2,
    H = I + sum over regions J' J,   b = sum J' r - c

Letters: c (K,) coefficients of the modes, J (3 n, K) and r (3 n,) whitened rows of one region
linearised at c.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch

from pipeline.posterior.seen_light import SeenLight
from pipeline.posterior.split_gibbs.gaussian_approximation import cholesky
from pipeline.posterior.split_gibbs.light_codes import Decoder, Modes, ModeUnknowns
from pipeline.posterior.split_gibbs.likelihood import whiteners
from pipeline.posterior.split_gibbs.lobes import BETWEEN, LobeTable
from pipeline.posterior.split_gibbs.material_moves import categorical
from pipeline.posterior.split_gibbs.material_prior import log_prior
from pipeline.posterior.split_gibbs.row_model import RowData, RowModel
from pipeline.posterior.split_gibbs.search_rows import SearchRows, Seen
from pipeline.posterior.split_gibbs.state import Noise, RegionMaterials
from pipeline.prior.gaussian import GaussianPrior

# relative error, and rows per independent one, assumed during the search
ERROR, THINNING = 0.05, 3.0
# steps of the light before materials are drawn
LIGHT_FIRST = 3
# leading modes of the Gaussian prior
SEARCH_COMPONENTS = 200
# weight of saturated rows where they hardly count
FEW = 0.05
# metallic that regions choose from, and roughness steps that whole objects do
CANDIDATES: tuple[float, ...] = (0.0, 1.0)
UNIFORM = [step * BETWEEN for step in (0, 2, 5)]
# deviations of any mode that one step may move it by: log light is linear nearby only
LONGEST = 3.0


def assumed_noise(data: RowData, saturated: float) -> Noise:
    """The errors assumed during the search; `saturated`: weight of saturated rows."""
    return Noise(ERROR, np.where(data.clipped.any(1), saturated, 1.0), THINNING)


@dataclass(frozen=True)
class Piece:
    """One region at one candidate: its materials, log-likelihood, J'J (K, K) and J'r (K,)."""

    materials: RegionMaterials
    value: float
    H: torch.Tensor
    b: torch.Tensor


class Linear:
    """The light (M', 3) at coefficients c (K,) and its changes per mode (3, K, M'). What is seen of
    the light itself is a piece beside those of the regions: value, H, b.
    """

    def __init__(self, c: torch.Tensor, light: np.ndarray, moved: torch.Tensor, seen: SeenLight):
        self.value = seen.value(light)
        weight = torch.from_numpy(seen.counted(light).T.astype(np.float32))
        J = weight[:, :, None] * moved[:, :, seen.pixel].transpose(1, 2)
        r = torch.from_numpy(seen.residual(light).T.astype(np.float32))
        self.H = torch.einsum("csk,csl->kl", J, J)
        self.b = torch.einsum("csk,cs->k", J, r)
        self.c = c
        self.light = torch.from_numpy(light.astype(np.float32))
        self.moved = moved


@dataclass(frozen=True)
class Search:
    """Draws of each region's roughness and metallic given the other regions'; light codes = mean +
    modes c with c ~ N(0, 1).

    log_scale: of the light, held; seen: what photos show of the light; saturated: weight of
    saturated rows.
    """

    rows: SearchRows
    decoder: Decoder
    unknowns: ModeUnknowns
    log_scale: float
    seen: SeenLight
    saturated: float = 1.0

    @classmethod
    def over(
        cls,
        data: RowData,
        gaussian: GaussianPrior,
        log_scale: float,
        points: int,
        rng: np.random.Generator,
    ) -> Search:
        """With about `points` of the points (`SearchRows.over`)."""
        rows = SearchRows.over(data, points, rng)
        light_rows = rows.data.light_rows
        modes = Modes(gaussian, gaussian, SEARCH_COMPONENTS, light_rows)
        unknowns = ModeUnknowns.seen(modes, gaussian.flat_mean)
        seen = SeenLight.of(data.sightings, light_rows)
        return cls(rows, Decoder.onto(gaussian, light_rows), unknowns, log_scale, seen)

    @property
    def lobes(self) -> LobeTable:
        """Of the rows."""
        return self.rows.data.lobes

    def counting_saturated(self, weight: float) -> Search:
        """The same search, in which saturated rows count by `weight`."""
        return replace(self, saturated=weight)

    def linear(self, c: torch.Tensor) -> Linear:
        """The light at coefficients c (K,), as the regions see it."""
        code = self.unknowns.code(c[None])
        light = self.decoder.light(code, self.log_scale)
        slope = self.decoder.slopes(code, self.log_scale)[1]
        return Linear(c, light, self.unknowns.modes.moved(slope), self.seen)

    def stepped(
        self, materials: RegionMaterials, at: Linear, step: torch.Tensor
    ) -> tuple[list[Piece], Linear]:
        """The light moved by a step (K,): pieces of all regions' materials there."""
        there = self.linear(damped(at.c, step))
        return self.pieces(materials, there), there

    def pieces(
        self, materials: RegionMaterials, at: Linear, regions: list[int] | None = None
    ) -> list[Piece]:
        """Regions, each at its part of the materials, with colours fitted to this light; all
        regions if not given. A region may come several times.
        """
        regions = list(range(len(self.rows))) if regions is None else regions
        data = self.rows.of(tuple(regions))
        model = RowModel(data, assumed_noise(data, self.saturated))
        lobes = self.rows.seen(regions, materials)
        U = (lobes.U @ at.light + lobes.ground_U).numpy().astype(np.float64)
        W = (lobes.W @ at.light + lobes.ground_W).numpy().astype(np.float64)
        materials = fitted_color(model, materials, U, W)

        J, r = linearised(model, lobes, at, U, W, materials)
        values = np.bincount(data.region, model.point_values(U, W, materials), len(regions))
        ends = np.searchsorted(data.row_region, np.arange(len(regions) + 1))
        found = []
        for k, value in enumerate(values):
            rows = slice(*ends[k : k + 2])
            mine = J[:, rows].reshape(-1, J.shape[2])
            b = mine.T @ r[:, rows].reshape(-1)
            found.append(Piece(materials.of([k]), float(value), mine.T @ mine, b))
        return found

    def draw_material(
        self,
        group: list[int],
        kinds: tuple[float, ...],
        pieces: list[Piece],
        at: Linear,
        rng: np.random.Generator,
    ) -> tuple[RegionMaterials, torch.Tensor]:
        """One roughness and a metallic of `kinds` for all regions of `group`, or what they have, by
        evidence: materials of all regions, and the light's step that goes with it (K,).
        """
        lobes = self.lobes
        choices = [
            (step, m)
            for step in range(0, len(lobes.roughness), BETWEEN)
            for m in kinds
            if m <= lobes.most_metallic[step]
        ]
        found = []
        for candidate in [pieces] + self.changed(group, choices, pieces, at):
            step, gain = light_step(candidate, at)
            prior = log_prior(joined(candidate), lobes.roughness) + shared(candidate, len(choices))
            evidence = gain + sum(p.value for p in candidate) + prior
            found.append((evidence, candidate, step))
        odds = np.array([[evidence for evidence, _, _ in found]])
        _, chosen, step = found[categorical(odds, rng)[0]]
        return joined(chosen), step

    def changed(
        self, group: list[int], choices: list[tuple[int, float]], pieces: list[Piece], at: Linear
    ) -> list[list[Piece]]:
        """`pieces` with the regions of `group` at every choice of roughness step and metallic."""
        of_group = joined([pieces[r] for r in group])
        asked = RegionMaterials.joined([of_group.made_of(*choice) for choice in choices])
        new = iter(self.pieces(asked, at, group * len(choices)))
        found = []
        for _ in choices:
            candidate = list(pieces)
            for r in group:
                candidate[r] = next(new)
            found.append(candidate)
        return found

    def settled(self, materials: RegionMaterials, at: Linear) -> tuple[list[Piece], Linear]:
        """Pieces of all regions' materials after a few steps of the light alone."""
        pieces = self.pieces(materials, at)
        for _ in range(LIGHT_FIRST):
            pieces, at = self.stepped(joined(pieces), at, light_step(pieces, at)[0])
        return pieces, at

    def sweep(
        self,
        order: list[list[int]],
        kinds: tuple[float, ...],
        materials: RegionMaterials,
        c: torch.Tensor,
        rng: np.random.Generator,
    ) -> tuple[RegionMaterials, torch.Tensor]:
        """Materials and coefficients (K,) after a draw for every group of `order`, of a metallic in
        `kinds`.
        """
        pieces, at = self.settled(materials, self.linear(c))
        for group in order:
            materials, step = self.draw_material(group, kinds, pieces, at, rng)
            pieces, at = self.stepped(materials, at, step)
        return joined(pieces), at.c

    def alone(
        self, materials: RegionMaterials, flat: Linear
    ) -> tuple[float, RegionMaterials, torch.Tensor]:
        """Log-evidence of materials by Laplace's method, where light and colours settle from the
        flat light; materials and coefficients (K,) there.
        """
        at = flat
        for weight in (FEW, 1.0):
            pieces, at = self.counting_saturated(weight).settled(materials, at)
            materials = joined(pieces)
        evidence = light_step(pieces, at)[1] + sum(p.value for p in pieces) + at.value
        prior = log_prior(materials, self.lobes.roughness)
        return evidence + prior, materials, at.c

    def run(
        self, materials: RegionMaterials, sweeps: int, rng: np.random.Generator
    ) -> list[tuple[RegionMaterials, torch.Tensor]]:
        """Step 2a: three starts, materials of all regions and a light code (3, m) each, after
        `sweeps` over all regions at once and each alone.

        One from `materials` and a flat light, the first sweep without much of the saturated rows:
        every one is too dark, and materials that spread highlights would explain them. One from the
        dielectric that has the most evidence for all regions, one from the metal, each with a light
        of its own. Moves of one material, given the light of others, end at peaks hundreds of nats
        apart, and which is the true one a light of 16 rows cannot say: it is too smooth to show a
        bright lamp, and so would have every gloss a metal. So the last two stay of their kind here.
        """
        regions = len(self.rows)
        flat = self.linear(torch.zeros(self.unknowns.size))
        starts = [(materials, flat.c, FEW, CANDIDATES)]
        for metallic in CANDIDATES:
            tried = [self.alone(whole, flat) for whole in self.uniform(materials, metallic)]
            if tried:
                _, best, c = max(tried, key=lambda start: start[0])
                starts.append((best, c, 1.0, (metallic,)))

        found = []
        for now, c, first_weight, kinds in starts:
            for sweep in range(sweeps):
                search = self.counting_saturated(1.0 if sweep else first_weight)
                order = [list(range(regions))] + [[r] for r in rng.permutation(regions)]
                now, c = search.sweep(order, kinds, now, c, rng)
            found.append((now, self.unknowns.code(c[None])))
        return found

    def uniform(self, materials: RegionMaterials, metallic: float) -> list[RegionMaterials]:
        """The materials with all regions of one metallic and one roughness of UNIFORM, as far as
        there are such.
        """
        most = self.lobes.most_metallic
        steps = sorted({min(step, len(most) - 1) for step in UNIFORM})
        return [materials.made_of(step, metallic) for step in steps if metallic <= most[step]]


def joined(pieces: list[Piece]) -> RegionMaterials:
    """The materials of all pieces."""
    return RegionMaterials.joined([p.materials for p in pieces])


def light_step(pieces: list[Piece], at: Linear) -> tuple[torch.Tensor, float]:
    """Newton step (K,) of the light's coefficients, and b' H^-1 b / 2 - log det H / 2."""
    factor = cholesky(torch.eye(len(at.c)) + sum((p.H for p in pieces), at.H))
    slope = sum((p.b for p in pieces), at.b) - at.c
    step = torch.cholesky_solve(slope[:, None], factor)[:, 0]
    return step, 0.5 * float(slope @ step) - float(factor.diagonal().log().sum())


def shared(pieces: list[Piece], choices: int) -> float:
    """Log-probability that regions share materials as they do: a Chinese restaurant process (Aldous
    1985), up to a constant.
    """
    have = [(p.materials.roughness[0], p.materials.metallic[0]) for p in pieces]
    return sum(np.log1p(choices * have[:r].count(material)) for r, material in enumerate(have))


def damped(c: torch.Tensor, step: torch.Tensor) -> torch.Tensor:
    """c moved by at most LONGEST deviations of any mode."""
    return c + step * min(1.0, LONGEST / max(float(step.abs().max()), 1e-9))


def linearised(
    model: RowModel,
    lobes: Seen,
    at: Linear,
    U: np.ndarray,
    W: np.ndarray,
    materials: RegionMaterials,
) -> tuple[torch.Tensor, torch.Tensor]:
    """Whitened rows J (3, n, K) and r (3, n) at a light of which the lobes see U and W (n, 3)."""
    color = torch.from_numpy(materials.color[model.data.row_region].astype(np.float32))
    rest = torch.from_numpy(model.rest(U, W, materials).astype(np.float32))
    J, r = [], []
    for c, whiten in enumerate(whiteners(model, U, W, materials)):
        T = torch.addcmul(lobes.W, color[:, c : c + 1], lobes.U)
        J.append(whiten(T @ at.moved[c].T))
        r.append(whiten(rest[:, c : c + 1])[:, 0])
    return torch.stack(J), torch.stack(r)


def fitted_color(
    model: RowModel, materials: RegionMaterials, U: np.ndarray, W: np.ndarray
) -> RegionMaterials:
    """The regions' materials with mean and spread of their points' best base colours, U and W
    (n, 3) being what the lobes see.
    """
    region = model.data.region
    precision = model.counted(U, W, materials)
    sums = model.sums(U, model.rest(U, W, materials), precision)
    colors = np.clip(model.colors(*sums, materials)[0], 1e-3, 1.2)

    first = np.searchsorted(region, np.arange(len(materials)))
    means = lambda x: np.add.reduceat(x, first, axis=0) / np.bincount(region)[:, None]
    mean = means(colors)
    color = np.clip(mean, 0.01, 0.95)
    deviation = np.sqrt(means((colors - mean[region]) ** 2))
    return replace(materials, color=color, spread=np.clip((deviation / color).mean(1), 0.05, 1.5))
