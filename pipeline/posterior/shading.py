"""What the light gives to every observed pixel, from few paths: L = a D + S.

a is the base colour, D the shading and S what does not scale with the base colour (highlights).
Only some pixels are path traced; between them D and S are interpolated within each photo by local
linear regression on the surface's normal and metallic, as feature regression removes the noise of
path-traced pictures (Bitterli et al. 2016). Shading is nearly linear in the normal over a few
pixels; highlights move with the view, so nothing is shared between photos.

Letters: n observed pixels, k traced ones, g guides, c values.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from pipeline.posterior.pixel_loops import add_moments, predict_into
from pipeline.posterior.problem import Problem, renderer_seed
from pipeline.posterior.textures import gather
from pipeline.render.observe import Observations
from pipeline.render.renderer import Explanation

PATHS = 2  # through each traced pixel, at least
MOST_PATHS = 32
PATHS_PER_CELL = 16.0  # of the regression, on average
FEWEST_PER_CELL = 2.0  # traced pixels
CELL_BLUR = 0.8  # cells over which sums are spread (standard deviation)
RIDGE = 0.02  # added to the guides' variance: where they are all alike the mean is taken
ENOUGH = 10.0  # traced pixels from which on the ridge is no larger
LEAST = 1e-3  # of D: some light reaches everything


@dataclass
class Shading:
    """L = a D + S of every observed pixel: `scaled` is D, `rest` is S, (n, 3) each; metallic (n,
    1): the share of D that the surface mirrors, and does not scatter.
    """

    scaled: np.ndarray
    rest: np.ndarray
    metallic: np.ndarray

    def under(self, factor: float) -> Shading:
        """The same under a light brighter by a factor."""
        return replace(self, scaled=factor * self.scaled, rest=factor * self.rest)

    def of(self, index: np.ndarray) -> Shading:
        """That of the pixels with these numbers."""
        return Shading(self.scaled[index], self.rest[index], self.metallic[index])


def shade(
    problem: Problem, explanation: Explanation, pixels: int, rng: np.random.Generator
) -> Shading:
    """D and S of all observed pixels, from PATHS paths through `pixels` of them, or as many paths
    in all where there are fewer. The base colour must not be zero anywhere.
    """
    count = len(problem.observations)
    traced = np.sort(rng.choice(count, min(pixels, count), replace=False))
    paths = int(np.clip(PATHS * pixels // len(traced), PATHS, MOST_PATHS))
    values = np.concatenate(split_picture(problem, explanation, traced, paths, rng), 1)

    metallic = gather(explanation.metallic, problem.observations.uv)
    guide = guides(problem, metallic)
    side = cell_side(problem.observations, len(traced), paths)
    out = np.zeros((count, 6), np.float32)
    for inside, among in pixels_by_view(problem.observations.view, traced):
        pixel = problem.observations.pixel
        at = (pixel[inside] - pixel[inside].min(0) + 0.5) / side - 0.5
        known = traced[among]
        at_known = at[np.searchsorted(inside, known)]
        cells = regress(at_known, guide[known], values[among], at.max(0))
        out[inside] = cells.predict(at, guide[inside])
    return Shading(np.maximum(out[:, :3], LEAST), out[:, 3:], metallic)


def split_picture(
    problem: Problem,
    explanation: Explanation,
    index: np.ndarray,
    paths: int,
    rng: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray]:
    """D and S (k, 3) of the pixels `index`, by `paths` paths through each.

    a D is twice the difference to the picture with half the base colour, with the same rays and
    random numbers.
    """
    half = replace(explanation, base_color=0.5 * explanation.base_color)
    rays = lambda of: problem.observations.rays(index, of)
    seed = renderer_seed(rng)

    pictures = []
    for maps in (explanation, half):
        problem.renderer.set(maps)
        pictures.append(problem.renderer.mean_radiance(rays, paths, seed))

    whole, with_half = pictures
    scaled = 2 * (whole - with_half)
    color = gather(explanation.base_color, problem.observations.uv[index])
    return scaled / color, whole - scaled


def guides(problem: Problem, metallic: np.ndarray) -> np.ndarray:
    """What D and S follow (n, 4): the shading normal in the world's frame, with the normal map, and
    metallic.
    """
    return np.concatenate([problem.shading_normals, metallic], 1)


def cell_side(observations: Observations, traced: int, paths: int) -> float:
    """Side in pixels of cells that hold PATHS_PER_CELL paths on average, through `traced` pixels of
    all; observed pixels may be a few of those in the mask.
    """
    columns, rows = observations.pixel.max(0).astype(int) // 8 + 1
    block_column, block_row = observations.pixel.T.astype(int) // 8
    count = np.bincount((observations.view * rows + block_row) * columns + block_column)
    observed_share = float(np.median(count[count > 0])) / 64
    traced_share = traced / len(observations) * observed_share
    return float(np.sqrt(max(PATHS_PER_CELL / paths, FEWEST_PER_CELL) / traced_share))


def pixels_by_view(view: np.ndarray, traced: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """For every view (n,) with traced pixels: the indices of its pixels, and positions in `traced`
    of those that are traced.
    """
    split = lambda values: [np.flatnonzero(values == k) for k in range(int(view.max()) + 1)]
    pairs = zip(split(view), split(view[traced]))
    return [(inside, among) for inside, among in pairs if len(among)]


@dataclass
class Cells:
    """Regressions of cells of a photo: coefficients (rows, columns, 1 + g, c), constant first, and
    the weight (rows, columns) that each was made from.
    """

    coefficients: np.ndarray
    weight: np.ndarray

    def predict(self, at: np.ndarray, guide: np.ndarray) -> np.ndarray:
        """Values (n, c) at cell coordinates `at` (n, 2) with guides (n, g), interpolated between
        cells by nearness and weight.
        """
        out = np.empty((len(at), self.coefficients.shape[-1]))
        predict_into(self.coefficients, self.weight, at, guide, out)
        return out


def regress(at: np.ndarray, guide: np.ndarray, values: np.ndarray, end: np.ndarray) -> Cells:
    """Ridge regression of `values` (k, c) on `guide` (k, g) in every cell and its neighbours.

    at (k, 2): column and row in cells, integers at their centres; end (2,): the largest in use.
    """
    g = guide.shape[1]
    columns, rows = np.maximum(np.round(end).astype(int), 0) + 1
    sums = cell_sums(at, guide, values, int(rows), int(columns))

    count = np.maximum(sums[..., :1, :1], 1e-9)
    mean = sums / count
    mean_guide = mean[..., 0, 1 : 1 + g]
    mean_value = mean[..., 0, 1 + g :]
    product = lambda of_values: mean_guide[..., :, None] * of_values[..., None, :]
    variance = mean[..., 1:, 1 : 1 + g] - product(mean_guide)
    covariance = mean[..., 1:, 1 + g :] - product(mean_value)

    ridge = RIDGE * ENOUGH / np.minimum(count, ENOUGH)
    slope = np.linalg.solve(variance + ridge * np.eye(g), covariance)
    constant = mean_value - np.einsum("yxg,yxgc->yxc", mean_guide, slope)
    return Cells(np.concatenate([constant[..., None, :], slope], -2), count[..., 0, 0])


def cell_sums(
    at: np.ndarray, guide: np.ndarray, values: np.ndarray, rows: int, columns: int
) -> np.ndarray:
    """Sums (rows, columns, 1 + g, 1 + g + c) of products of (1, guide) with (1, guide, values) over
    the pixels of every cell, spread over its neighbours.
    """
    cell = np.clip(np.round(at).astype(int), 0, [columns - 1, rows - 1])
    number = cell[:, 1] * columns + cell[:, 0]
    g, c = guide.shape[1], values.shape[1]
    sums = np.zeros((rows * columns, 1 + g, 1 + g + c))
    add_moments(number, guide, values, sums)

    images = sums.reshape(rows, columns, -1)
    images = cv2.GaussianBlur(images, (0, 0), CELL_BLUR, borderType=cv2.BORDER_CONSTANT)
    return images.reshape(rows, columns, 1 + g, 1 + g + c)
