"""Moves of the materials: without photos they draw the prior."""

from types import SimpleNamespace

import numpy as np

from pipeline.posterior.split_gibbs.likelihood import point_materials
from pipeline.posterior.split_gibbs.lobes import BETWEEN, METALLIC
from pipeline.posterior.split_gibbs.material_moves import draw_offsets, draw_regions
from pipeline.posterior.split_gibbs.material_prior import (
    CHROMA,
    COMMON,
    DIELECTRIC,
    METAL,
    METALLIC_PRIOR,
    TAIL,
)
from pipeline.posterior.split_gibbs.state import RegionMaterials

# of eight roughness steps: no rough metals
MOST_METALLIC = np.repeat([1.0, 0.2], 4)
# a model of two points, a region each, whose rows say nothing
SILENT = SimpleNamespace(
    data=SimpleNamespace(
        region=np.array([0, 1]),
        rows=SimpleNamespace(point=np.array([0, 1])),
        lobes=SimpleNamespace(roughness=range(8), most_metallic=MOST_METALLIC),
    ),
    point_values=lambda U, W, materials: np.zeros(2),
)


def from_the_prior(rng) -> RegionMaterials:
    """Two regions, directly: Student's t as a normal over a chi, impossible colours and rough
    metals thrown away.
    """
    root = np.linalg.cholesky((1 - COMMON) * np.eye(2) + COMMON)
    student = lambda k: root @ rng.normal(size=(2, k)) * np.sqrt(TAIL / rng.chisquare(TAIL))
    across = np.linalg.svd(np.ones((1, 3)))[2][1:]
    odds = np.exp(METALLIC_PRIOR)
    while True:
        roughness = rng.integers(8, size=2)
        m = rng.choice(METALLIC, 2, p=odds / odds.sum())
        centre, width = ((1 - m) * a + m * b for a, b in zip(DIELECTRIC, METAL))
        bright = (centre + width * student(1)[:, 0])[:, None]
        color = np.exp(bright + CHROMA * student(2) @ across)
        if color.max() < 0.98 and (m <= MOST_METALLIC[roughness]).all():
            return RegionMaterials(color, np.full(2, 0.3), roughness, m)


def figures(draws: list[RegionMaterials]) -> np.ndarray:
    """Quartiles of one region's log brightness, share of metals, mean roughness step over 8, share
    of times that both regions are on one side of its median, tint.
    """
    log_color = np.log([t.color for t in draws])
    bright, metal = log_color.mean(2), np.array([t.metallic[0] > 0.5 for t in draws])
    middle = np.median(bright)
    tint = np.median(np.abs(log_color[:, 0] - bright[:, :1]))
    roughness = np.mean([t.roughness[0] for t in draws]) / 8
    together = ((bright > middle).sum(1) != 1).mean()
    quartiles = np.percentile(bright[:, 0], [25, 50, 75])
    return np.array([*quartiles, metal.mean(), roughness, together, tint])


def test_moves_leave_the_prior_as_it_is():
    """Every chain starts with a draw of the prior, and still is one after 40 steps of wide
    moves.
    """
    rng = np.random.default_rng(0)
    first = [from_the_prior(rng) for _ in range(2500)]
    seen, offsets = np.zeros((8, 4, 2, 3)), np.zeros((2, 2), int)
    step = np.full(2, 0.5)
    last = [draw_regions(SILENT, seen, t, offsets, 40, rng, step)[0] for t in first]
    moved = np.mean([np.abs(a.color - b.color).max() > 0.01 for a, b in zip(first, last)])
    assert moved > 0.9 and (step == 0.5).all()
    np.testing.assert_allclose(figures(last), figures(first), atol=0.06)


class Two:
    """Two regions of 60 points; a point's log-likelihood falls with the distance of its roughness
    step from a target, or says nothing.
    """

    def __init__(self, targets, sharpness):
        steps = 8 * BETWEEN
        self.data = SimpleNamespace(
            region=np.repeat([0, 1], 60),
            rows=SimpleNamespace(point=np.arange(120)),
            lobes=SimpleNamespace(roughness=range(steps), most_metallic=np.ones(steps)),
        )
        self.targets, self.sharpness = targets, sharpness

    def point_values(self, U, W, materials):
        """U is what the lobes see: here the roughness step itself (`steps_seen`)."""
        return -0.5 * self.sharpness * (U[:, 0] - self.targets) ** 2


def steps_seen() -> np.ndarray:
    """Lobes (steps, 4, 120, 3) of which U, for dielectrics, is the roughness step."""
    seen = np.zeros((8 * BETWEEN, 4, 120, 3))
    seen[:, 0] = np.arange(8 * BETWEEN)[:, None, None]
    return seen


def plain_regions() -> RegionMaterials:
    """Two grey dielectrics of one roughness."""
    return RegionMaterials(
        np.full((2, 3), 0.3), np.full(2, 0.3), np.array([4, 4]) * BETWEEN, np.zeros(2)
    )


def drawn_offsets(targets, sharpness, rng) -> np.ndarray:
    """Offsets (2, 120), beginning with none."""
    none = np.zeros((2, 120), int)
    found = draw_offsets(Two(targets, sharpness), steps_seen(), plain_regions(), none, rng)
    assert not none.any()
    return found


def test_points_leave_their_region_where_the_photos_say_so():
    """One region of one roughness, one with every other point two traced steps up: found point by
    point.
    """
    targets = np.full(120, 4.0 * BETWEEN)
    targets[60::2] += 2 * BETWEEN
    offset = drawn_offsets(targets, 10.0, np.random.default_rng(0))
    assert (offset[0, :60] == 0).all()
    assert np.abs(offset[0, 60:] - (targets[60:] - 4 * BETWEEN)).mean() < 0.1


def test_points_stay_with_their_region_where_the_photos_say_nothing():
    """Then the width of a region's points comes from its prior: of 200 regions, half have none."""
    rng, alone = np.random.default_rng(1), []
    region = np.repeat([0, 1], 60)
    for _ in range(100):
        offset = drawn_offsets(np.zeros(120), 0.0, rng)
        alone += [(offset[0][region == r] == 0).all() for r in (0, 1)]
    assert abs(np.mean(alone) - 0.5) < 3 * (0.25 / 200) ** 0.5


def test_offsets_stay_among_the_roughnesses_and_metals_there_are():
    data = Two(np.zeros(120), 0.0).data
    far = np.full((2, 120), 99)
    roughness, metallic = point_materials(data, plain_regions(), far)
    assert (roughness == 8 * BETWEEN - 1).all() and (metallic == 1).all()
