"""Step 2a: what a chain may begin with, whole objects of one gloss, each with a light of its own.

Roughness and light explain each other: a sharp highlight is a sharp gloss under a broad lamp, or a
rough one under a small, brighter one. A chain comes from a start that is too sharp to rough
materials in a few sweeps, for what is matt tells little of the light's details; from one that is
too rough it hardly comes to sharp ones, for its light has no lamps to be reflected. So starts span
all glosses of either kind, and sweeps decide between them (sampler.py).

Each light is the likeliest under the leading modes of the Gaussian prior, by Gauss-Newton steps on
some of the points and a light of ROWS rows:

    c <- c + H^-1 (J' r - c),    H = I + J' J

Letters: c (K,) coefficients of the modes, J (3 n, K) and r (3 n,) whitened rows linearised at c.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch

from pipeline.posterior.split_gibbs.coherence import Neighbours
from pipeline.posterior.split_gibbs.gaussian_approximation import cholesky
from pipeline.posterior.split_gibbs.light_codes import Decoder, Modes, ModeUnknowns
from pipeline.posterior.split_gibbs.likelihood import Mixer, RowLikelihood, RowsUnder
from pipeline.posterior.split_gibbs.lobes import LobeTable
from pipeline.posterior.split_gibbs.pooling import pooled
from pipeline.posterior.split_gibbs.row_model import RowData, RowModel
from pipeline.posterior.split_gibbs.state import Noise, RegionMaterials
from pipeline.prior.gaussian import GaussianPrior
from pipeline.render.rows import Rows

Start = tuple[RegionMaterials, torch.Tensor]  # of all regions, and a light code (3, m)

# edges of the intervals of roughness that whole objects begin with, by metallic: denser ones gain
# on some things and lose on most, for the best of many by noisy odds is a chance one
GLOSSES = {0.0: (0.1, 0.2, 0.35, 0.55, 0.8), 1.0: (0.15, 0.28, 0.5)}
# relative error, and rows per independent one, that are assumed
ERROR, THINNING = 0.05, 3.0
# rows of the light, and leading modes of the Gaussian prior: no finer
ROWS, COMPONENTS = 16, 200
# points that every region keeps at least: small ones have a say too
FEWEST = 8
# weight of saturated rows in the first steps, every one of which is too dark under a flat light
# (what spreads highlights would explain them), and then; steps with each
WEIGHTS, STEPS = (0.05, 1.0), 4
# deviations of any mode that one step may move it by: log light is linear nearby only
LONGEST = 3.0


@dataclass(frozen=True)
class FewRows:
    """Some of the points' rows for a coarse light, light between parts of the object left out.

    log_scale: of the light, held.
    """

    mixer: Mixer
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
    ) -> FewRows:
        """With about `points` of the points, and FEWEST of each region at least."""
        share = min(1.0, points / len(data.region))
        kept = []
        for r in range(data.region.max() + 1):
            mine = rng.permutation(np.flatnonzero(data.region == r))
            kept.append(mine[: max(FEWEST, round(share * len(mine)))])
        some = subset(data, np.sort(np.concatenate(kept)), min(ROWS, data.light_rows))
        modes = Modes(gaussian, gaussian, COMPONENTS, some.light_rows)
        unknowns = ModeUnknowns.seen(modes, gaussian.flat_mean)
        return cls(Mixer(some), Decoder.onto(gaussian, some.light_rows), unknowns, log_scale)

    def starts(self, materials: RegionMaterials, rng: np.random.Generator) -> list[Start]:
        """Step 2a: `materials` and whole objects (`uniform`), with colours and a light that fit."""
        tried = [materials, *uniform(materials, self.mixer.data.lobes, rng)]
        return [self.settled(whole) for whole in tried]

    def settled(self, materials: RegionMaterials) -> Start:
        """The materials, and the light from the flat one on, after steps of both in turn."""
        data, c = self.mixer.data, torch.zeros(self.unknowns.size)
        offsets = np.zeros((3, len(data.region)), int)
        offsets[2] = data.lobes.usual
        for weight in WEIGHTS:
            noise = Noise(ERROR, np.where(data.clipped.any(1), weight, 1.0), THINNING)
            for _ in range(STEPS):
                rows = RowLikelihood.at(self.mixer, noise, materials, offsets)
                light = self.decoder.light(self.unknowns.code(c[None]), self.log_scale)
                materials = fitted_color(rows.model, materials, *rows.predict(light))
                c = self.stepped(replace(rows, materials=materials).under(light), c)
        return materials, self.unknowns.code(c[None])

    def stepped(self, rows: RowsUnder, c: torch.Tensor) -> torch.Tensor:
        """Coefficients (K,) after one step from c, whose light the rows are under; no mode is moved
        by more than LONGEST.
        """
        slope = self.decoder.slope(self.unknowns.code(c[None]), self.log_scale)
        T, r, _ = rows.expansion()
        moved = self.unknowns.modes.moved(slope)
        J = torch.einsum("cnm,ckm->cnk", T, moved).reshape(-1, len(c))
        factor = cholesky(torch.eye(len(c)) + J.T @ J)
        step = torch.cholesky_solve((J.T @ r.reshape(-1) - c)[:, None], factor)[:, 0]
        return c + step * min(1.0, LONGEST / max(float(step.abs().max()), 1e-9))


def uniform(
    materials: RegionMaterials, lobes: LobeTable, rng: np.random.Generator
) -> list[RegionMaterials]:
    """The materials with all regions of one kind and one roughness, random in its log within each
    interval of GLOSSES, as far as there are such.
    """
    known, found = np.log(lobes.roughness), []
    for metallic, edges in GLOSSES.items():
        for drawn in rng.uniform(np.log(edges[:-1]), np.log(edges[1:])):
            step = int(np.abs(known - drawn).argmin())
            if metallic <= lobes.most_metallic[step]:
                found.append(materials.made_of(step, metallic))
    return found


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

    count = np.bincount(region)[:, None]
    means = lambda x: np.stack([np.bincount(region, column) for column in x.T], 1) / count
    mean = means(colors)
    color = np.clip(mean, 0.01, 0.95)
    deviation = np.sqrt(means((colors - mean[region]) ** 2))
    return replace(materials, color=color, spread=np.clip((deviation / color).mean(1), 0.05, 1.5))


def subset(data: RowData, points: np.ndarray, light_rows: int) -> RowData:
    """Some of the points only (ascending indices), seen by lobes for lights of `light_rows` rows;
    light between parts is left out, that of the ground stays.
    """
    rows = np.flatnonzero(np.isin(data.rows.point, points))
    point = np.searchsorted(points, data.rows.point[rows])
    return replace(
        data,
        lobes=coarse_lobes(data, rows, light_rows),
        light_rows=light_rows,
        bounces=1,
        rows=Rows(data.rows.observation[rows], point),
        observed=data.observed[rows],
        clipped=data.clipped[rows],
        region=data.region[points],
        point_weight=data.point_weight[points],
        told=data.told[rows],
        neighbours=Neighbours.none(len(points)),
    )


def coarse_lobes(data: RowData, rows: np.ndarray, light_rows: int) -> LobeTable:
    """Lobes of some rows, for lights of `light_rows` rows."""
    index = torch.from_numpy(rows)
    direct = [pooled(F[:, index], light_rows) for F in data.lobes.direct]
    off = [[matrix[rows] for matrix in of_step] for of_step in data.lobes.off]
    return replace(data.lobes, direct=direct, off=off)
