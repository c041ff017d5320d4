"""Brightness of points in the photos that show them, without a place for the others: of a hundred
photos and a hundred thousand points few pairs were matched.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np


@dataclass(frozen=True)
class Readings:
    """One entry for each photo that shows a point, in order of photos and then of points.

    view, point: indices (n,); value: of each, (n,) or (n, c), NaN where it is unknown; views,
    points: how many there are.
    """

    view: np.ndarray
    point: np.ndarray
    value: np.ndarray
    views: int
    points: int

    @classmethod
    def of(cls, table: np.ndarray) -> Readings:
        """From a table (views, points) or (views, points, c), NaN where unknown."""
        known = np.isfinite(table)
        view, point = np.nonzero(known if table.ndim == 2 else known.any(2))
        return cls(view, point, table[view, point], *table.shape[:2])

    def chosen(self, keep: np.ndarray) -> Readings:
        """The entries `keep`, (n,) bool or indices."""
        return replace(self, view=self.view[keep], point=self.point[keep], value=self.value[keep])

    def channel(self, c: int) -> Readings:
        """The known values (n,) of one channel, float64."""
        one = replace(self, value=self.value[:, c].astype(float))
        return one.chosen(np.isfinite(one.value))

    def of_views(self, keep: np.ndarray) -> Readings:
        """The views `keep`, (views,) bool, numbered anew."""
        number = np.cumsum(keep) - 1
        some = self.chosen(keep[self.view])
        return replace(some, view=number[some.view], views=int(keep.sum()))

    def of_points(self, keep: np.ndarray) -> Readings:
        """The points `keep`, (points,) bool, numbered anew."""
        number = np.cumsum(keep) - 1
        some = self.chosen(keep[self.point])
        return replace(some, point=number[some.point], points=int(keep.sum()))

    def less(self, of_view: np.ndarray) -> Readings:
        """Values (n,) less those of their photo, (views,)."""
        return replace(self, value=self.value - of_view[self.view])

    def sum_of_points(self, values: np.ndarray) -> np.ndarray:
        """Sums (points,) over the photos of values (n,)."""
        return np.bincount(self.point, values, self.points)

    def sum_of_views(self, values: np.ndarray) -> np.ndarray:
        """Sums (views,) over the points of values (n,)."""
        return np.bincount(self.view, values, self.views)

    def photos_of_points(self) -> np.ndarray:
        """By how many photos each point is shown, (points,)."""
        return np.bincount(self.point, minlength=self.points)
