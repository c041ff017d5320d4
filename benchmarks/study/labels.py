"""Labels of a chart, placed so that they cross nothing: neither what is drawn nor each other.

All in pixels of the finished layout: `Labels` freezes it.
"""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.path import Path
from matplotlib.text import Annotation, Text
from matplotlib.transforms import Bbox

SIZE = 7  # points
HEIGHT = 0.05  # of a label with the air around it, share of the axes' height
AIR = 1.5  # pixels kept around a label
MARKER = 9.0  # side in pixels that is kept free around a point
PLACES = tuple(  # of a label around its point, nearest first: offset in points, alignment
    ((x * (5 if y else reach), y * reach), across, along)
    for reach in range(5, 60)
    for y, along in ((1, "bottom"), (-1, "top"), (0, "center"))
    for x, across in ((1, "left"), (-1, "right"), (0, "center"))
    if (x, y) != (0, 0)
)
LEADER = {"arrowstyle": "-", "lw": 0.4, "color": "#777777", "shrinkB": 3, "relpos": (0, 0.5)}


def apart(heights: list[float], lines: list[float]) -> list[float]:
    """Heights of the labels of points at `heights`, as shares of the axes: each at its point's or
    just above the label below it, and clear of lines across; all moved down where they would end
    above the axes.
    """

    def clear(height: float, way: int) -> float:
        for line in sorted(lines, key=lambda line: way * line):
            if abs(height - line) < HEIGHT / 2:
                height = line + way * HEIGHT / 2
        return height

    out = list(heights)
    order = sorted(range(len(heights)), key=lambda k: heights[k])
    last = -np.inf
    for k in order:
        last = out[k] = clear(max(heights[k], last + HEIGHT), 1)
    below = 1.0
    for k in reversed(order):
        below = out[k] = clear(min(out[k], below - HEIGHT), -1)
    return out


def box_of(label: Annotation) -> Bbox:
    """Of the text alone: an annotation's own box holds its leader too."""
    label.update_positions(label.figure.canvas.get_renderer())
    return Text.get_window_extent(label)


def box_path(box: Bbox) -> Path:
    """Once around a box."""
    return Path([box.min, (box.x1, box.y0), box.max, (box.x0, box.y1), box.min])


class Labels:
    """Places labels on axes whose limits and lines are final."""

    def __init__(self, axes: Axes):
        figure = axes.figure
        figure.draw_without_rendering()
        figure.set_layout_engine("none")
        self.axes = axes
        self.taken = [line.get_transform().transform_path(line.get_path()) for line in axes.lines]
        for bars in axes.collections:
            self.taken += [bars.get_transform().transform_path(path) for path in bars.get_paths()]

    def keep_free(self, at: tuple[float, float]) -> None:
        """No label comes over the marker of a point, in data."""
        x, y = self.axes.transData.transform(at)
        self.taken.append(box_path(Bbox.from_bounds(x, y, 0, 0).padded(MARKER / 2)))

    def crossings(self, label: Annotation) -> int:
        """How many lines, markers and labels a label comes over or near, and whether it leaves the
        axes.
        """
        box = box_of(label).padded(AIR)
        inside = all(self.axes.bbox.contains(*corner) for corner in (box.min, box.max))
        return sum(path.intersects_bbox(box, filled=False) for path in self.taken) + (not inside)

    def beside(self, text: str, at: tuple[float, float], color: str) -> None:
        """A label at the nearest place around a point where it crosses nothing, or the least."""
        label = self.axes.annotate(
            text, at, (0, 0), textcoords="offset points", fontsize=SIZE, color=color
        )
        put = lambda place: label.set(position=place[0], ha=place[1], va=place[2])
        crossed = []
        for place in PLACES:
            put(place)
            crossed.append(self.crossings(label))
        put(PLACES[crossed.index(min(crossed))])
        self.taken.append(box_path(box_of(label)))

    def along(self, text: str, x: float) -> None:
        """A label that runs down a line across all heights at `x`, in data, from its upper end."""
        where = {"xycoords": self.axes.get_xaxis_transform(), "textcoords": "offset points"}
        turned = {"rotation": 90, "ha": "right", "va": "top", "fontsize": SIZE}
        label = self.axes.annotate(text, (x, 1), (-4, -4), **where, **turned)
        self.taken.append(box_path(box_of(label)))

    def column(
        self, texts: list[str], points: list[tuple[float, float]], at: float, across: list[float]
    ) -> None:
        """Labels below each other that begin at `at`, each with a line to its point, clear of lines
        across at the heights `across`; all in data.
        """
        low, high = self.axes.get_ylim()
        share = lambda value: (value - low) / (high - low)
        heights = apart([share(y) for _, y in points], [share(y) for y in across])
        for text, point, height in zip(texts, points, heights):
            where = (at, low + height * (high - low))
            label = self.axes.annotate(
                text, point, where, fontsize=SIZE, va="center", arrowprops=LEADER
            )
            self.taken.append(box_path(box_of(label)))
            self.taken.append(Path(self.axes.transData.transform([where, point])))
