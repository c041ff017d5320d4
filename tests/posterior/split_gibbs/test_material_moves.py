"""Moves of the materials: without photos they draw the prior."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

from pipeline.posterior.split_gibbs.likelihood import point_materials
from pipeline.posterior.split_gibbs.lobes import BETWEEN, METALLIC
from pipeline.posterior.split_gibbs.material_moves import (
    accepted,
    draw_offsets,
    draw_regions,
    propose_all,
    propose_spread,
)
from pipeline.posterior.split_gibbs.material_prior import (
    CHROMA,
    COMMON,
    DIELECTRIC,
    METAL,
    METALLIC_PRIOR,
    SPREAD_PRIOR,
    TAIL,
    log_color_prior,
    log_prior,
)
from pipeline.posterior.split_gibbs.state import RegionMaterials

# of eight roughness steps: no rough metals
MOST_METALLIC = np.repeat([1.0, 0.2], 4)
# a model of two points, a region each, whose rows say nothing
SILENT = SimpleNamespace(
    data=SimpleNamespace(
        region=np.array([0, 1]),
        rows=SimpleNamespace(point=np.array([0, 1])),
        lobes=SimpleNamespace(
            roughness=range(8), most_metallic=MOST_METALLIC, blurred=np.arange(8)[:, None]
        ),
    ),
    point_values=lambda U, W, materials: np.zeros(2),
)


def from_the_prior(count: int, rng) -> list[RegionMaterials]:
    """Draws of two regions, directly: Student's t as a normal over a chi, impossible colours and
    rough metals thrown away.
    """
    root = np.linalg.cholesky((1 - COMMON) * np.eye(2) + COMMON)
    across = np.linalg.svd(np.ones((1, 3)))[2][1:]
    tried = 4 * count
    chi = np.sqrt(TAIL / rng.chisquare(TAIL, (2, tried, 1, 1)))
    student = lambda k: root @ rng.normal(size=(tried, 2, k)) * chi[k - 1]

    roughness = rng.integers(8, size=(tried, 2))
    odds = np.exp(METALLIC_PRIOR)
    m = rng.choice(METALLIC, (tried, 2), p=odds / odds.sum())
    centre, width = ((1 - m) * a + m * b for a, b in zip(DIELECTRIC, METAL))
    bright = centre + width * student(1)[..., 0]
    color = np.exp(bright[..., None] + CHROMA * student(2) @ across)

    possible = (color.max((1, 2)) < 0.98) & (m <= MOST_METALLIC[roughness]).all(1)
    kept = np.flatnonzero(possible)[:count]
    assert len(kept) == count
    return [RegionMaterials(color[k], np.full(2, 0.3), roughness[k], m[k]) for k in kept]


def figures(draws: list[RegionMaterials], edges: np.ndarray) -> np.ndarray:
    """Shares of one region's log brightness below `edges` (3,), share of metals, mean roughness
    step over 8, share of times that both regions are on one side of the middle edge, tint.
    """
    log_color = np.log([t.color for t in draws])
    bright, metal = log_color.mean(2), np.array([t.metallic[0] > 0.5 for t in draws])
    return np.array(
        [
            *(bright[:, :1] < edges).mean(0),
            metal.mean(),
            np.mean([t.roughness[0] for t in draws]) / 8,
            ((bright > edges[1]).sum(1) != 1).mean(),
            np.median(np.abs(log_color[:, 0] - bright[:, :1])),
        ]
    )


@pytest.mark.slow
def test_moves_leave_the_prior_as_it_is():
    """Every chain starts with a draw of the prior, and still is one after 20 steps of wide moves:
    to four deviations of each figure.
    """
    rng = np.random.default_rng(0)
    many, first = from_the_prior(40_000, rng), from_the_prior(1250, rng)
    seen, offsets, step = np.zeros((8, 4, 2, 3)), np.zeros((3, 2), int), np.full(2, 0.5)
    last = [draw_regions(SILENT, seen, t, offsets, 20, rng, step)[0] for t in first]
    moved = np.mean([np.abs(a.color - b.color).max() > 0.01 for a, b in zip(first, last)])
    assert moved > 0.9 and (step == 0.5).all()

    edges = np.quantile([np.log(t.color[0]).mean() for t in many], [0.25, 0.5, 0.75])
    exact = figures(many, edges)
    parts = [figures(many[k : k + 1250], edges) for k in range(0, 40_000, 1250)]
    deviation = np.std(parts, axis=0, ddof=1)
    assert deviation.max() < 0.016
    assert (np.abs(figures(last, edges) - exact) < 4 * deviation).all()


def some_materials(regions: int, rng) -> RegionMaterials:
    """Anything possible."""
    return RegionMaterials(
        rng.uniform(0.02, 0.95, (regions, 3)),
        rng.uniform(0.05, 1.0, regions),
        rng.integers(8, size=regions),
        rng.choice(METALLIC, regions),
    )


def test_prior_of_the_materials_is_students_t():
    """Ratios of densities of three regions against scipy's: brightness of all regions together, the
    two directions of their tint together, metallic and spread each by itself.
    """
    rng = np.random.default_rng(0)
    shape = (1 - COMMON) * np.eye(3) + COMMON
    across = np.linalg.svd(np.ones((1, 3)))[2][1:]

    def expected(t: RegionMaterials) -> float:
        log_color, m = np.log(t.color), t.metallic
        centre, width = ((1 - m) * a + m * b for a, b in zip(DIELECTRIC, METAL))
        bright = stats.multivariate_t(centre, np.outer(width, width) * shape, df=TAIL)
        tint = stats.multivariate_t(np.zeros(6), CHROMA**2 * np.kron(shape, np.eye(2)), df=TAIL)
        spread = stats.norm(*SPREAD_PRIOR).logpdf(np.log(t.spread)).sum()
        metallic = sum(METALLIC_PRIOR[METALLIC.tolist().index(value)] for value in m)
        tints = tint.logpdf((log_color @ across.T).ravel())
        return bright.logpdf(log_color.mean(1)) + tints + spread + metallic

    draws = [some_materials(3, rng) for _ in range(50)]
    difference = [log_prior(t) - expected(t) for t in draws]
    np.testing.assert_allclose(difference, difference[0], atol=1e-9)

    color = draws[0].color.copy()
    color[1, 2] = 0.985
    assert log_prior(replace(draws[0], color=color)) == -np.inf


def test_regions_are_accepted_one_after_the_other():
    """By Metropolis's rule on the prior of all colours together, times what speaks for each."""
    rng = np.random.default_rng(0)
    for seed in range(50):
        now, new, gain = some_materials(4, rng), some_materials(4, rng), rng.normal(size=4)
        found = accepted(now, new, gain, np.random.default_rng(seed))
        color, m = now.color.copy(), now.metallic.copy()
        for r, threshold in enumerate(np.log(np.random.default_rng(seed).random(4))):
            other_color, other_m = color.copy(), m.copy()
            other_color[r], other_m[r] = new.color[r], new.metallic[r]
            ratio = log_color_prior(other_color, other_m) - log_color_prior(color, m)
            assert found[r] == (threshold < gain[r] + ratio)
            if found[r]:
                color, m = other_color, other_m


def test_proposals_are_symmetric():
    """From a to b as often as from b to a, of roughness and metallic; steps of log colour and of
    spread as often up as down, whatever the place.
    """
    rng, n = np.random.default_rng(0), 200_000
    start = RegionMaterials(
        np.full((n, 3), 0.3), np.full(n, 0.3), rng.integers(8, size=n), rng.choice(METALLIC, n)
    )
    new = propose_all(start, 8, rng, np.full(n, 0.5))
    at = lambda t: t.roughness * len(METALLIC) + np.searchsorted(METALLIC, t.metallic)
    states = 8 * len(METALLIC)
    flow = np.bincount(at(start) * states + at(new), minlength=states**2).reshape(states, states)
    both = flow + flow.T
    often = np.triu(both >= 20, 1)
    assert often.sum() > 300
    z = (flow - flow.T)[often] / np.sqrt(both[often])
    assert abs((z**2).mean() - 1) < 5 * np.sqrt(2 / often.sum()) and np.abs(z).max() < 4.5

    steps = np.log(new.color / start.color)
    assert steps.std() > 0.2
    for column in (*steps.T, steps.sum(1)):
        assert stats.kstest(column[::2], -column[1::2]).pvalue > 1e-3
    moved = propose_spread(start, 8, rng, np.full(n, 0.5))
    spread = np.log(moved.spread / start.spread)
    assert spread.std() > 0.2 and stats.kstest(spread[::2], -spread[1::2]).pvalue > 1e-3


class Two:
    """Two regions of 60 points; a point's log-likelihood falls with the distance of its roughness
    step from a target, or says nothing.
    """

    def __init__(self, targets, sharpness):
        steps = 8 * BETWEEN
        self.data = SimpleNamespace(
            region=np.repeat([0, 1], 60),
            rows=SimpleNamespace(point=np.arange(120)),
            lobes=SimpleNamespace(
                roughness=range(steps),
                most_metallic=np.ones(steps),
                blurred=np.arange(steps)[:, None],
            ),
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
    none = np.zeros((3, 120), int)
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
