"""How the points of a region lie off it: a Markov random field over neighbours of like colour.

A region is of one kind and one roughness, and its points may differ: worn edges, a badge, a stain.
What differs does so in patches that end where the colour does. So every point has two labels, and
neighbours of a region prefer the same ones (Potts 1952 for the kind; Besag 1986: what neighbours
share is what a picture's true labels do). Where the photos say nothing, a region is whole.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree
from scipy.special import logsumexp

from pipeline.posterior.split_gibbs.lobes import BETWEEN

# what `offsets` may hold, per row: steps of roughness from the region's, and whether a point's
# metallic is the region's or the other kind's
OFFSETS = BETWEEN * np.arange(-3, 4), np.arange(2)
AS_REGION, OTHER = range(2)
# log odds of every label for a point by itself
ALONE = -1.0 * np.abs(np.arange(-3, 4)), np.array([0.0, -2.5])
# log odds that a neighbour of the same colour adds for each label of it
FAVOUR = -0.7 * np.abs(np.subtract.outer(np.arange(7), np.arange(7))), 1.0 * np.eye(2)
# of the nearest points, and how far log colours may lie apart (`regions.features`)
NEAREST, ALIKE = 5, 0.25


@dataclass(frozen=True)
class Neighbours:
    """For every point the points beside it in its region: index (p, k) and weight (p, k) in [0, 1],
    0 where it has fewer. Symmetric.
    """

    index: np.ndarray
    weight: np.ndarray

    @classmethod
    def of(cls, position: np.ndarray, feature: np.ndarray, region: np.ndarray) -> Neighbours:
        """From position (p, 3), features of colour (p, f) and region (p,): two points count where
        either is among the NEAREST of the other, by how alike their colours are.
        """
        points = len(position)
        nearest = min(NEAREST + 1, points)
        found = cKDTree(position).query(position, np.arange(1, nearest + 1))[1][:, 1:]
        pairs = np.stack([np.repeat(np.arange(points), nearest - 1), found.ravel()], 1)
        pairs = np.unique(np.sort(pairs, 1), axis=0)
        pairs = pairs[region[pairs[:, 0]] == region[pairs[:, 1]]]
        far = ((feature[pairs[:, 0]] - feature[pairs[:, 1]]) ** 2).sum(1)
        return cls.joining(points, pairs, np.exp(-0.5 * far / ALIKE**2))

    @classmethod
    def joining(cls, points: int, pairs: np.ndarray, weight: np.ndarray) -> Neighbours:
        """From pairs (e, 2) of neighbours, each once, and their weight (e,)."""
        one = np.concatenate([pairs[:, 0], pairs[:, 1]])
        order = np.argsort(one, kind="stable")
        one, other = one[order], np.concatenate([pairs[:, 1], pairs[:, 0]])[order]
        count = np.bincount(one, minlength=points)
        column = np.arange(len(one)) - (np.cumsum(count) - count)[one]
        shape = points, max(int(count.max(initial=0)), 1)
        index, of_pair = np.zeros(shape, int), np.zeros(shape)
        index[one, column] = other
        of_pair[one, column] = np.concatenate([weight, weight])[order]
        return cls(index, of_pair)

    @classmethod
    def none(cls, points: int) -> Neighbours:
        """Points that know nothing of each other."""
        return cls(np.zeros((points, 1), int), np.zeros((points, 1)))


def draw_labels(
    neighbours: Neighbours,
    log_odds: np.ndarray,
    favour: np.ndarray,
    label: np.ndarray,
    sweeps: int,
    rng: np.random.Generator,
) -> np.ndarray:
    """Labels (p,) after Gibbs sweeps over all points in random order, from `label` (p,).

    log_odds (p, k): of every label of a point by itself; favour (k, k), symmetric: log odds of a
    pair of labels of neighbours, times their weight.
    """
    label = label.copy()
    for _ in range(sweeps):
        chance = log_odds + rng.gumbel(size=log_odds.shape)
        for p in rng.permutation(len(label)):
            beside = neighbours.weight[p] @ favour[label[neighbours.index[p]]]
            label[p] = (chance[p] + beside).argmax()
    return label


def log_field(
    neighbours: Neighbours, log_odds: np.ndarray, favour: np.ndarray, label: np.ndarray
) -> np.ndarray:
    """Log-density of the labels (p,) by point, up to a constant: half of every pair's for each."""
    pairs = favour[label[:, None], label[neighbours.index]] * neighbours.weight
    return log_odds[np.arange(len(label)), label] + 0.5 * pairs.sum(1)


def draw_in_order(
    neighbours: Neighbours, log_odds: np.ndarray, favour: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """Labels (p,) drawn one point after the other, each given those before it."""
    chance = log_odds + rng.gumbel(size=log_odds.shape)
    before = earlier(neighbours)
    label = np.zeros(len(log_odds), int)
    for p in range(len(label)):
        label[p] = (chance[p] + before[p] @ favour[label[neighbours.index[p]]]).argmax()
    return label


def log_in_order(
    neighbours: Neighbours, log_odds: np.ndarray, favour: np.ndarray, label: np.ndarray
) -> np.ndarray:
    """Log-probability by point (p,) with which `draw_in_order` draws these labels."""
    beside = (earlier(neighbours)[..., None] * favour[label[neighbours.index]]).sum(1)
    odds = log_odds + beside
    return odds[np.arange(len(label)), label] - logsumexp(odds, 1)


def earlier(neighbours: Neighbours) -> np.ndarray:
    """`neighbours.weight` (p, k) of points that come before; 0 of others."""
    own = np.arange(len(neighbours.index))[:, None]
    return np.where(neighbours.index < own, neighbours.weight, 0)
