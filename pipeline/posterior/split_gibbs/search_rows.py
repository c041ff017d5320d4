"""The rows that the search for start materials looks at: some points of every region, seen by lobes
for a coarse light.

Many materials of many regions are looked at together, each as a region of its own: a few large
arrays cost a fraction of many small ones.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
import torch

from pipeline.posterior.split_gibbs.coherence import Neighbours
from pipeline.posterior.split_gibbs.lobes import LobeTable, mix
from pipeline.posterior.split_gibbs.pooling import pooled
from pipeline.posterior.split_gibbs.row_model import RowData
from pipeline.posterior.split_gibbs.state import RegionMaterials
from pipeline.render.rows import Rows

# rows of the light: the modes are no finer
ROWS = 16
# points that every region keeps at least: small ones have a say too
FEWEST = 8


class Seen(NamedTuple):
    """Lobes of n rows mixed by metallic: U and W (n, M) for the light, and what the ground adds to
    what they see, ground_U and ground_W (n, 3), or (n, 1) zeros.
    """

    U: torch.Tensor
    W: torch.Tensor
    ground_U: torch.Tensor
    ground_W: torch.Tensor


@dataclass(frozen=True)
class SearchRows:
    """data: points sorted by region, for lights of `data.light_rows` rows; ends (R + 1,) and
    point_ends (R + 1,): first row and first point of every region, and the ends of the last.
    """

    data: RowData
    ends: np.ndarray
    point_ends: np.ndarray
    chosen: dict[tuple[int, ...], RowData] = field(default_factory=dict)
    mixed: dict[tuple[int, int, float], Seen] = field(default_factory=dict)

    @classmethod
    def over(cls, data: RowData, points: int, rng: np.random.Generator) -> SearchRows:
        """With `points` of the points in all, and FEWEST of each region at least."""
        share = min(1.0, points / len(data.region))
        kept = []
        for r in range(data.region.max() + 1):
            mine = rng.permutation(np.flatnonzero(data.region == r))
            kept.append(np.sort(mine[: max(FEWEST, round(share * len(mine)))]))
        some = subset(data, np.concatenate(kept), min(ROWS, data.light_rows))
        point_ends = np.cumsum([0] + [len(points) for points in kept])
        return cls(some, np.searchsorted(some.rows.point, point_ends), point_ends)

    def __len__(self) -> int:
        return len(self.ends) - 1

    def of(self, regions: tuple[int, ...]) -> RowData:
        """Some of the regions, each time that one comes as a region of its own."""
        if regions not in self.chosen:
            data = self.data
            points = [np.arange(*self.point_ends[r : r + 2]) for r in regions]
            rows = np.concatenate([np.arange(*self.ends[r : r + 2]) for r in regions])
            size = [len(p) for p in points]
            moved = np.cumsum([0] + size[:-1]) - self.point_ends[list(regions)]
            of_row = np.repeat(moved, [self.ends[r + 1] - self.ends[r] for r in regions])
            self.chosen[regions] = part(
                data,
                rows,
                np.concatenate(points),
                data.rows.point[rows] + of_row,
                np.repeat(np.arange(len(regions)), size),
            )
        return self.chosen[regions]

    def lobes(self, r: int, roughness: int, metallic: float) -> Seen:
        """Region r's lobes at a roughness step and a metallic, its normals spreading as is
        usual.
        """
        lobes = self.data.lobes
        shown = int(lobes.blurred[roughness, lobes.usual])
        if (r, shown, metallic) not in self.mixed:
            rows = slice(*self.ends[r : r + 2])
            ground = torch.from_numpy(lobes.from_ground(shown)[:, rows])
            seen = Seen(*mix(lobes.at(shown, rows), metallic), *mix(ground, metallic))
            self.mixed[r, shown, metallic] = seen
        return self.mixed[r, shown, metallic]

    def seen(self, regions: list[int], materials: RegionMaterials) -> Seen:
        """Lobes of the rows of `of`, each region at its part of the materials."""
        choices = zip(regions, materials.roughness, materials.metallic)
        lobes = [self.lobes(r, int(step), float(metallic)) for r, step, metallic in choices]
        return Seen(*(torch.cat(column) for column in zip(*lobes)))


def part(
    data: RowData, rows: np.ndarray, points: np.ndarray, point: np.ndarray, region: np.ndarray
) -> RowData:
    """Rows (indices) of points (indices): each row's index among these points, and the region of
    each.
    """
    return replace(
        data,
        rows=Rows(data.rows.observation[rows], point),
        observed=data.observed[rows],
        clipped=data.clipped[rows],
        region=region,
        ceiling=data.ceiling[points],
        point_weight=data.point_weight[points],
        told=data.told[rows],
        neighbours=Neighbours.none(len(points)),
    )


def subset(data: RowData, points: np.ndarray, light_rows: int) -> RowData:
    """Some of the points only, in this order, seen by lobes for lights of `light_rows` rows; light
    between parts is left out, that of the ground stays.
    """
    place = np.full(len(data.region), -1)
    place[points] = np.arange(len(points))
    point = place[data.rows.point]
    rows = np.argsort(point, kind="stable")[(point < 0).sum() :]
    lobes = coarse_lobes(data, rows, light_rows)
    some = part(data, rows, points, point[rows], data.region[points])
    return replace(some, lobes=lobes, light_rows=light_rows, bounces=1)


def coarse_lobes(data: RowData, rows: np.ndarray, light_rows: int) -> LobeTable:
    """Lobes of some rows, for lights of `light_rows` rows and that of the ground."""
    lobes, nodes = data.lobes, len(data.transport.node_position)
    index = torch.from_numpy(rows)
    direct = [pooled(F[:, index], light_rows) for F in lobes.direct]
    of_ground = [[matrix[rows, nodes:] for matrix in of_step] for of_step in lobes.off]
    return replace(lobes, direct=direct, off=of_ground)
