"""Moves of the materials: without photos they draw the prior."""

from types import SimpleNamespace

import numpy as np
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
    draw_offsets,
    draw_regions,
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


def from_the_prior(rng) -> Theta:
    """Two regions, directly: Student's t as a normal over a chi, impossible colours and rough
    metals thrown away.
    """
    root = np.linalg.cholesky((1 - COMMON) * np.eye(2) + COMMON)
    student = lambda k: root @ rng.normal(size=(2, k)) * np.sqrt(TAIL / rng.chisquare(TAIL))
    across = np.linalg.svd(np.ones((1, 3)))[2][1:]
    while True:
        level, m = (
            rng.integers(8, size=2),
            rng.choice(METALLIC, 2, p=np.exp(METALLIC_PRIOR) / np.exp(METALLIC_PRIOR).sum()),
        )
        centre, width = ((1 - m) * a + m * b for a, b in zip(DIELECTRIC, METAL))
        mu = np.exp((centre + width * student(1)[:, 0])[:, None] + CHROMA * student(2) @ across)
        if mu.max() < 0.98 and (m <= MOST_METALLIC[level]).all():
            return Theta(mu, np.full(2, 0.3), level, m)


def figures(thetas: list[Theta]) -> np.ndarray:
    """Quartiles of one region's log brightness, share of metals, mean level over 8, share of times
    that both regions are on one side of its median, tint.
    """
    log_mu = np.log([t.mu for t in thetas])
    bright, metal = log_mu.mean(2), np.array([t.m[0] > 0.5 for t in thetas])
    middle = np.median(bright)
    tint = np.median(np.abs(log_mu[:, 0] - bright[:, :1]))
    level = np.mean([t.level[0] for t in thetas]) / 8
    return np.array(
        [
            *np.percentile(bright[:, 0], [25, 50, 75]),
            metal.mean(),
            level,
            ((bright > middle).sum(1) != 1).mean(),
            tint,
        ]
    )


def test_moves_leave_the_prior_as_it_is():
    """Every chain starts with a draw of the prior, and still is one after 40 steps of wide
    moves.
    """
    rng = np.random.default_rng(0)
    first = [from_the_prior(rng) for _ in range(2500)]
    lobes = np.zeros((8, 4, 2, 3))
    last = [draw_regions(SILENT, lobes, t, 40, rng, np.full(2, 0.5)) for t in first]
    moved = np.mean([np.abs(a.mu - b.mu).max() > 0.01 for a, b in zip(first, last)])
    assert moved > 0.9
    np.testing.assert_allclose(figures(last), figures(first), atol=0.06)


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
