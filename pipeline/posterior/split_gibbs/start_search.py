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

from pipeline.posterior.split_gibbs.coherence import Neighbours
from pipeline.posterior.split_gibbs.gaussian_approximation import cholesky
from pipeline.posterior.split_gibbs.light_codes import Decoder, Modes, ModeUnknowns
from pipeline.posterior.split_gibbs.likelihood import whiteners
from pipeline.posterior.split_gibbs.lobes import BETWEEN, LobeTable, mix
from pipeline.posterior.split_gibbs.material_moves import categorical
from pipeline.posterior.split_gibbs.material_prior import log_prior
from pipeline.posterior.split_gibbs.pooling import pooled
from pipeline.posterior.split_gibbs.row_model import RowData, RowModel
from pipeline.posterior.split_gibbs.state import Noise, RegionMaterials
from pipeline.prior.gaussian import GaussianPrior
from pipeline.render.rows import Rows

# rows of the light: the modes are no finer
ROWS = 16
# relative error, and rows per independent one, assumed during the search
ERROR, THINNING = 0.1, 3.0
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


def coarse_lobes(data: RowData) -> tuple[LobeTable, int]:
    """Lobes for lights of at most ROWS rows, and their rows."""
    light_rows = min(ROWS, data.light_rows)
    direct = [pooled(F, light_rows) for F in data.lobes.direct]
    return replace(data.lobes, direct=direct), light_rows


def subset(data: RowData, lobes: LobeTable, light_rows: int, points: np.ndarray) -> RowData:
    """Some of the points only, as one region, seen by `coarse_lobes`; `points` sorted.

    The search leaves light between parts out.
    """
    keep = np.isin(data.rows.point, points)
    mine = torch.from_numpy(keep)
    return RowData(
        transport=data.transport,
        lobes=replace(lobes, direct=[F[:, mine] for F in lobes.direct], off=[]),
        rows=Rows(data.rows.observation[keep], np.searchsorted(points, data.rows.point[keep])),
        observed=data.observed[keep],
        clipped=data.clipped[keep],
        region=np.zeros(len(points), int),
        ceiling=data.ceiling[points],
        point_weight=data.point_weight[points],
        light_rows=light_rows,
        bounces=1,
        neighbours=Neighbours.none(len(points)),
    )


def assumed_noise(data: RowData, saturated: float) -> Noise:
    """The errors assumed during the search; `saturated`: weight of saturated rows."""
    return Noise(ERROR, np.where(data.clipped, saturated, 1.0), THINNING)


@dataclass(frozen=True)
class Piece:
    """One region at one candidate: its materials, log-likelihood, J'J (K, K) and J'r (K,)."""

    materials: RegionMaterials
    value: float
    H: torch.Tensor
    b: torch.Tensor


class Linear:
    """What the lobes of every region make of the light (M', 3) of coefficients c (K,) and of its
    changes per mode (3, K, M'): small matrices, of which those of any metallic are mixed.
    """

    def __init__(
        self, parts: list[RowData], c: torch.Tensor, light: np.ndarray, moved: torch.Tensor
    ):
        self.parts = parts
        self.c = c
        self.light = torch.from_numpy(light.astype(np.float32))
        self.moved = moved
        self.known: dict[tuple[int, int], tuple[np.ndarray, torch.Tensor]] = {}

    def lobes(self, r: int, roughness: int) -> tuple[np.ndarray, torch.Tensor]:
        """Region r's four lobes at a roughness step, its normals spreading as is usual: under the
        light (4, n, 3), and under its modes (3, 4, n, K).
        """
        lobes = self.parts[r].lobes
        shown = int(lobes.blurred[roughness, lobes.usual])
        if (r, shown) not in self.known:
            F = lobes.at(shown)
            under_modes = torch.stack([F @ change.T for change in self.moved])
            self.known[r, shown] = (F @ self.light).numpy(), under_modes
        return self.known[r, shown]


@dataclass(frozen=True)
class Search:
    """Draws of each region's roughness and metallic given the other regions'; light codes = mean +
    modes c with c ~ N(0, 1).

    parts: a region each; noise: the errors assumed for each; log_scale: of the light, held.
    """

    parts: list[RowData]
    noise: list[Noise]
    decoder: Decoder
    unknowns: ModeUnknowns
    log_scale: float

    @classmethod
    def over(
        cls,
        data: RowData,
        gaussian: GaussianPrior,
        log_scale: float,
        points: int,
        rng: np.random.Generator,
    ) -> Search:
        """With `points` of the points in all; every region keeps at least 8: small ones have a say
        too.
        """
        part_kept = min(1.0, points / len(data.region))
        lobes, light_rows = coarse_lobes(data)
        parts = []
        for r in range(data.region.max() + 1):
            mine = rng.permutation(np.flatnonzero(data.region == r))
            kept = np.sort(mine[: max(8, round(part_kept * len(mine)))])
            parts.append(subset(data, lobes, light_rows, kept))
        modes = Modes(gaussian, gaussian, SEARCH_COMPONENTS, light_rows)
        unknowns = ModeUnknowns.seen(modes, gaussian.flat_mean)
        noise = [assumed_noise(part, 1.0) for part in parts]
        return cls(parts, noise, Decoder.onto(gaussian, light_rows), unknowns, log_scale)

    def counting_saturated(self, weight: float) -> Search:
        """The same search, in which saturated rows count by `weight`."""
        return replace(self, noise=[assumed_noise(part, weight) for part in self.parts])

    def linear(self, c: torch.Tensor) -> Linear:
        """The light at coefficients c (K,), as the regions see it."""
        code = self.unknowns.code(c[None])
        light = self.decoder.light(code, self.log_scale)
        slope = self.decoder.slopes(code, self.log_scale)[1]
        return Linear(self.parts, c, light, self.unknowns.modes.moved(slope))

    def stepped(
        self, materials: RegionMaterials, at: Linear, step: torch.Tensor
    ) -> tuple[list[Piece], Linear]:
        """The light moved by a step (K,): pieces of all regions' materials there."""
        there = self.linear(damped(at.c, step))
        return self.pieces(materials, there), there

    def piece(self, r: int, materials: RegionMaterials, at: Linear) -> Piece:
        """Region r with materials, its colour fitted to this light."""
        model = RowModel(self.parts[r], self.noise[r])
        metallic = float(materials.metallic[0])
        light, modes = at.lobes(r, int(materials.roughness[0]))
        U, W = mix(light, metallic)
        materials = fitted_color(model, materials, U, W)
        rest = model.rest(U, W, materials)

        H, b = torch.zeros(()), torch.zeros(())
        for c, whiten in enumerate(whiteners(model, U, W, materials)):
            u, w = mix(modes[c], metallic)
            J = whiten(float(materials.color[0, c]) * u + w)
            r_c = torch.from_numpy(rest[:, c : c + 1].astype(np.float32))
            H, b = H + J.T @ J, b + J.T @ whiten(r_c)[:, 0]
        return Piece(materials, float(model.point_values(U, W, materials).sum()), H, b)

    def pieces(self, materials: RegionMaterials, at: Linear) -> list[Piece]:
        """Every region at its part of the materials."""
        return [self.piece(r, materials.of([r]), at) for r in range(len(self.parts))]

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
        lobes = self.parts[0].lobes
        choices = [
            (step, m)
            for step in range(0, len(lobes.roughness), BETWEEN)
            for m in kinds
            if m <= lobes.most_metallic[step]
        ]

        def changed(choice: tuple[int, float]) -> list[Piece]:
            return [
                self.piece(r, p.materials.made_of(*choice), at) if r in group else p
                for r, p in enumerate(pieces)
            ]

        found = []
        for candidate in [pieces] + [changed(choice) for choice in choices]:
            step, gain = light_step(candidate, at.c)
            prior = log_prior(joined(candidate), lobes.roughness) + shared(candidate, len(choices))
            evidence = gain + sum(p.value for p in candidate) + prior
            found.append((evidence, candidate, step))
        odds = np.array([[evidence for evidence, _, _ in found]])
        _, chosen, step = found[categorical(odds, rng)[0]]
        return joined(chosen), step

    def settled(self, materials: RegionMaterials, at: Linear) -> tuple[list[Piece], Linear]:
        """Pieces of all regions' materials after a few steps of the light alone."""
        pieces = self.pieces(materials, at)
        for _ in range(LIGHT_FIRST):
            pieces, at = self.stepped(joined(pieces), at, light_step(pieces, at.c)[0])
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
        evidence = light_step(pieces, at.c)[1] + sum(p.value for p in pieces)
        prior = log_prior(materials, self.parts[0].lobes.roughness)
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
        regions = len(self.parts)
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
        most = self.parts[0].lobes.most_metallic
        steps = sorted({min(step, len(most) - 1) for step in UNIFORM})
        return [materials.made_of(step, metallic) for step in steps if metallic <= most[step]]


def joined(pieces: list[Piece]) -> RegionMaterials:
    """The materials of all pieces."""
    return RegionMaterials.joined([p.materials for p in pieces])


def light_step(pieces: list[Piece], c: torch.Tensor) -> tuple[torch.Tensor, float]:
    """Newton step (K,) of the light's coefficients at c, and b' H^-1 b / 2 - log det H / 2."""
    factor = cholesky(torch.eye(len(c)) + sum(p.H for p in pieces))
    slope = sum(p.b for p in pieces) - c
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


def fitted_color(
    model: RowModel, materials: RegionMaterials, U: np.ndarray, W: np.ndarray
) -> RegionMaterials:
    """The region's materials with mean and spread of the points' best base colours, U and W (n, 3)
    being what its lobes see.
    """
    precision = model.counted(U, W, materials)
    sums = model.sums(U, model.rest(U, W, materials), precision)
    colors = np.clip(model.colors(*sums, materials)[0], 1e-3, 1.2)
    color, spread = materials.color.copy(), materials.spread.copy()
    color[0] = np.clip(colors.mean(0), 0.01, 0.95)
    spread[0] = np.clip((colors.std(0) / color[0]).mean(), 0.05, 1.5)
    return replace(materials, color=color, spread=spread)
