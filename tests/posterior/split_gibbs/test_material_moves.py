"""Moves of the materials: without photos they draw the prior."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

from pipeline.posterior.split_gibbs.likelihood import BETWEEN, NU, Photos, Theta
from pipeline.posterior.split_gibbs.material_moves import (
    CHROMA,
    COMMON,
    DIELECTRIC,
    METAL,
    METALLIC,
    METALLIC_PRIOR,
    TAIL,
    TAU_PRIOR,
    accepted,
    draw_offsets,
    draw_regions,
    log_colour_prior,
    log_prior,
    propose,
    propose_spread,
)
from pipeline.posterior.split_gibbs.regions import group, texel_regions
from pipeline.posterior.split_gibbs.sampler import BLOCKS, SHARES, block_shares, sharpest

MOST_METALLIC = np.repeat([1.0, 0.2], 4)  # of eight levels: no rough metals
SILENT = SimpleNamespace(
    region=np.array([0, 1]),
    rows=SimpleNamespace(point=np.array([0, 1])),
    point_materials=lambda t: (t.level, t.m),
    point_values=lambda U, W, t: np.zeros(2),
    lobes=SimpleNamespace(most_metallic=MOST_METALLIC),
)


def from_the_prior(count: int, rng) -> list[Theta]:
    """Draws of two regions, directly: Student's t as a normal over a chi, impossible colours and
    rough metals thrown away.
    """
    root = np.linalg.cholesky((1 - COMMON) * np.eye(2) + COMMON)
    across = np.linalg.svd(np.ones((1, 3)))[2][1:]
    tried = 4 * count
    chi = np.sqrt(TAIL / rng.chisquare(TAIL, (2, tried, 1, 1)))
    student = lambda k: root @ rng.normal(size=(tried, 2, k)) * chi[k - 1]

    level = rng.integers(8, size=(tried, 2))
    odds = np.exp(METALLIC_PRIOR)
    m = rng.choice(METALLIC, (tried, 2), p=odds / odds.sum())
    centre, width = ((1 - m) * a + m * b for a, b in zip(DIELECTRIC, METAL))
    bright = centre + width * student(1)[..., 0]
    mu = np.exp(bright[..., None] + CHROMA * student(2) @ across)

    possible = (mu.max((1, 2)) < 0.98) & (m <= MOST_METALLIC[level]).all(1)
    kept = np.flatnonzero(possible)[:count]
    assert len(kept) == count
    return [Theta(mu[k], np.full(2, 0.3), level[k], m[k]) for k in kept]


def figures(thetas: list[Theta], edges: np.ndarray) -> np.ndarray:
    """Shares of one region's log brightness below `edges` (3,), share of metals, mean level over 8,
    share of times that both regions are on one side of the middle edge, tint.
    """
    log_mu = np.log([t.mu for t in thetas])
    bright, metal = log_mu.mean(2), np.array([t.m[0] > 0.5 for t in thetas])
    return np.array(
        [
            *(bright[:, :1] < edges).mean(0),
            metal.mean(),
            np.mean([t.level[0] for t in thetas]) / 8,
            ((bright > edges[1]).sum(1) != 1).mean(),
            np.median(np.abs(log_mu[:, 0] - bright[:, :1])),
        ]
    )


@pytest.mark.slow
def test_moves_leave_the_prior_as_it_is():
    """Every chain starts with a draw of the prior, and still is one after 20 steps of wide moves:
    to four deviations of each figure.
    """
    rng = np.random.default_rng(0)
    many, first = from_the_prior(40_000, rng), from_the_prior(1250, rng)
    lobes = np.zeros((8, 4, 2, 3))
    last = [draw_regions(SILENT, lobes, t, 20, rng, np.full(2, 0.5)) for t in first]
    moved = np.mean([np.abs(a.mu - b.mu).max() > 0.01 for a, b in zip(first, last)])
    assert moved > 0.9

    edges = np.quantile([np.log(t.mu[0]).mean() for t in many], [0.25, 0.5, 0.75])
    exact = figures(many, edges)
    parts = [figures(many[k : k + 1250], edges) for k in range(0, 40_000, 1250)]
    deviation = np.std(parts, axis=0, ddof=1)
    assert deviation.max() < 0.016
    assert (np.abs(figures(last, edges) - exact) < 4 * deviation).all()


def test_prior_of_the_materials_is_students_t():
    """Ratios of densities of three regions against scipy's: brightness of all regions together, the
    two directions of their tint together, metallic and spread each by itself.
    """
    rng = np.random.default_rng(0)
    shape = (1 - COMMON) * np.eye(3) + COMMON
    across = np.linalg.svd(np.ones((1, 3)))[2][1:]

    def expected(theta: Theta) -> float:
        log_mu = np.log(theta.mu)
        centre, width = ((1 - theta.m) * a + theta.m * b for a, b in zip(DIELECTRIC, METAL))
        bright = stats.multivariate_t(centre, np.outer(width, width) * shape, df=TAIL)
        tint = stats.multivariate_t(np.zeros(6), CHROMA**2 * np.kron(shape, np.eye(2)), df=TAIL)
        spread = stats.norm(*TAU_PRIOR).logpdf(np.log(theta.tau)).sum()
        metallic = sum(METALLIC_PRIOR[METALLIC.tolist().index(m)] for m in theta.m)
        return (
            bright.logpdf(log_mu.mean(1))
            + tint.logpdf((log_mu @ across.T).ravel())
            + spread
            + metallic
        )

    draw = lambda: Theta(
        rng.uniform(0.02, 0.95, (3, 3)),
        rng.uniform(0.05, 1.0, 3),
        rng.integers(8, size=3),
        rng.choice(METALLIC, 3),
    )
    thetas = [draw() for _ in range(50)]
    difference = [log_prior(t) - expected(t) for t in thetas]
    np.testing.assert_allclose(difference, difference[0], atol=1e-9)

    impossible = thetas[0].copy()
    impossible.mu[1, 2] = 0.985
    assert log_prior(impossible) == -np.inf


def test_regions_are_accepted_one_after_the_other():
    """By Metropolis's rule on the prior of all colours together, times what speaks for each."""
    rng = np.random.default_rng(0)
    draw = lambda: Theta(
        rng.uniform(0.02, 0.95, (4, 3)), np.full(4, 0.3), np.zeros(4, int), rng.choice(METALLIC, 4)
    )
    for seed in range(50):
        theta, new, gain = draw(), draw(), rng.normal(size=4)
        found = accepted(theta, new, gain, np.random.default_rng(seed))
        mu, m = theta.mu.copy(), theta.m.copy()
        for r, level in enumerate(np.log(np.random.default_rng(seed).random(4))):
            other_mu, other_m = mu.copy(), m.copy()
            other_mu[r], other_m[r] = new.mu[r], new.m[r]
            ratio = log_colour_prior(other_mu, other_m) - log_colour_prior(mu, m)
            assert found[r] == (level < gain[r] + ratio)
            if found[r]:
                mu, m = other_mu, other_m


def test_proposals_are_symmetric():
    """From a to b as often as from b to a, of roughness and metallic; steps of log colour and of
    spread as often up as down, whatever the place.
    """
    rng, n = np.random.default_rng(0), 200_000
    start = Theta(
        np.full((n, 3), 0.3), np.full(n, 0.3), rng.integers(8, size=n), rng.choice(METALLIC, n)
    )
    new = propose(start, 8, rng, np.full(n, 0.5))
    at = lambda t: t.level * len(METALLIC) + np.searchsorted(METALLIC, t.m)
    states = 8 * len(METALLIC)
    flow = np.bincount(at(start) * states + at(new), minlength=states**2).reshape(states, states)
    both = flow + flow.T
    often = np.triu(both >= 20, 1)
    assert often.sum() > 300
    z = (flow - flow.T)[often] / np.sqrt(both[often])
    assert abs((z**2).mean() - 1) < 5 * np.sqrt(2 / often.sum()) and np.abs(z).max() < 4.5

    steps = np.log(new.mu / start.mu)
    assert steps.std() > 0.2
    for column in (*steps.T, steps.sum(1)):
        assert stats.kstest(column[::2], -column[1::2]).pvalue > 1e-3
    moved = propose_spread(start, 8, rng, np.full(n, 0.5))
    spread = np.log(moved.tau / start.tau)
    assert spread.std() > 0.2 and stats.kstest(spread[::2], -spread[1::2]).pvalue > 1e-3


def test_block_shares_are_even_in_the_mean_and_uneven_between_blocks():
    rng, position = np.random.default_rng(1), np.random.default_rng(2).normal(size=(300, 3))
    shares = np.array([block_shares(position, rng) for _ in range(200)])
    assert np.allclose(shares.mean(1), 1) and all(len(np.unique(s)) == BLOCKS for s in shares)
    assert np.abs(shares.mean(0) - 1).max() < 0.5 and 0.5 < shares.std(1).mean() < 1.3


def test_regions_follow_the_base_colour_and_not_its_shade():
    """Three paints, each in light and shadow by a fifth, are three regions, on points and on
    texels.
    """
    rng = np.random.default_rng(3)
    paints = np.array([[0.6, 0.1, 0.1], [0.1, 0.5, 0.2], [0.4, 0.4, 0.5]])
    which = rng.integers(3, size=400)
    label, centers = group(paints[which] * rng.uniform(0.8, 1.2, (400, 1)))
    assert label.max() == 2 and all(len(np.unique(label[which == k])) == 1 for k in range(3))
    texture = np.repeat(np.repeat(paints[None, [0, 1, 2, 2]], 16, 1), 64, 0).astype(np.float32)
    found = texel_regions(texture, centers, 32)
    expected = [label[which == k][0] for k in (0, 1, 2)]
    assert [np.median(found[:, a:b]) for a, b in ((0, 7), (9, 15), (17, 32))] == expected


def test_normals_that_wobble_show_no_sharp_lobe():
    """alpha^2 = 2 sigma^2: exact normals set no bound, 5.5 degrees one near .34, wild ones leave
    rough lobes over.
    """
    assert (
        sharpest(0.0) == 0
        and abs(sharpest(np.radians(5.47)) - 0.34) < 0.01
        and sharpest(2.0) == 0.8
    )
    sigma = 0.08
    tilts = np.linalg.norm(sigma * np.random.default_rng(0).normal(size=(20000, 2)), axis=1)
    assert abs(sharpest(float(np.median(tilts))) ** 4 - 2 * sigma**2) < 0.05 * 2 * sigma**2


def test_draws_differ_in_what_they_take_for_one_material():
    """The share of the spread that regions explain is drawn: four paints, two of them alike, are
    from two to four regions, never split oddly.
    """
    rng, paints = (
        np.random.default_rng(5),
        np.array([[0.6, 0.1, 0.1], [0.5, 0.14, 0.1], [0.1, 0.5, 0.2], [0.15, 0.15, 0.6]]),
    )
    which = np.arange(400) % 4
    colours = paints[which] * rng.uniform(0.95, 1.05, (400, 1))
    found = [group(colours, rng.uniform(*SHARES), k)[0] for k in range(20)]
    counts = {label.max() + 1 for label in found}
    assert len(counts) > 1 and counts <= {2, 3, 4}
    assert group(colours, SHARES[0])[0].max() < group(colours, SHARES[1])[0].max()
    assert all(
        len(np.unique(label[which == k])) == 1
        for label in found
        if label.max() + 1 <= 3
        for k in range(4)
    )


class Two:
    """Two regions of 60 points; a point's log-likelihood falls with the distance of its level from
    a target, or says nothing.
    """

    def __init__(self, targets, sharpness):
        self.region, self.offset = np.repeat([0, 1], 60), np.zeros((2, 120), int)
        self.targets, self.sharpness = targets, sharpness
        self.rows, self.lobes = (
            SimpleNamespace(point=np.arange(120)),
            SimpleNamespace(levels=range(8 * BETWEEN), most_metallic=np.ones(8 * BETWEEN)),
        )

    point_materials = Photos.point_materials

    def point_values(self, U, W, theta):
        return -0.5 * self.sharpness * (self.point_materials(theta)[0] - self.targets) ** 2


def drawn_offsets(targets, sharpness) -> np.ndarray:
    photos, theta = (
        Two(targets, sharpness),
        Theta(np.full((2, 3), 0.3), np.full(2, 0.3), np.array([4, 4]) * BETWEEN, np.zeros(2)),
    )
    draw_offsets(photos, np.zeros((8 * BETWEEN, 4, 120, 3)), theta, np.random.default_rng(0))
    return photos.offset


def test_noise_density_is_students_t():
    """Of three channels with one lambda, against scipy; an explained saturated row says nothing, an
    unexplained one less than nothing.
    """
    relative = np.random.default_rng(0).normal(size=(50, 3)) ** 2
    density = lambda eta, free, clipped: Photos.log_noise(
        SimpleNamespace(
            misfit=lambda *_: (np.where(free, 0, relative), free), eta=eta, clipped=clipped
        ),
        None,
        None,
        None,
    )
    none, flat = np.zeros((50, 3), bool), np.zeros(50, bool)
    t = lambda eta: (
        stats.multivariate_t(np.zeros(3), eta**2 * np.eye(3), df=NU).logpdf(np.sqrt(relative)).sum()
    )
    assert np.isclose(density(0.5, none, flat) - density(2.0, none, flat), t(0.5) - t(2.0))
    first = np.arange(50) == 0
    assert density(0.01, none, first) < density(0.01, none | first[:, None], first)


def test_points_leave_their_region_where_the_photos_say_so():
    """One region of one level, one with every other point two levels up: found point by point; the
    silent metallic stays as drawn from the prior.
    """
    targets = np.full(120, 4.0 * BETWEEN)
    targets[60::2] += 2 * BETWEEN
    offset = drawn_offsets(targets, 10.0)
    assert (offset[0, :60] == 0).all()
    assert np.abs(offset[0, 60:] - (targets[60:] - 4 * BETWEEN)).mean() < 0.1


def test_points_stay_with_their_region_where_the_photos_say_nothing():
    """Then the width of a region's points comes from its prior: of 200 regions, half have none."""
    rng, alone = np.random.default_rng(1), []
    for _ in range(100):
        photos, theta = (
            Two(np.zeros(120), 0.0),
            Theta(np.full((2, 3), 0.3), np.full(2, 0.3), np.array([4, 4]) * BETWEEN, np.zeros(2)),
        )
        draw_offsets(photos, np.zeros((8 * BETWEEN, 4, 120, 3)), theta, rng)
        alone += [(photos.offset[0][photos.region == r] == 0).all() for r in (0, 1)]
    assert abs(np.mean(alone) - 0.5) < 3 * (0.25 / 200) ** 0.5
