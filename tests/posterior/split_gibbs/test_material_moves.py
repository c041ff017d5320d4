"""Moves of the materials: without photos they draw the prior."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats
from scipy.special import gammaln

from pipeline.posterior.problem import ALBEDO_MAX
from pipeline.posterior.split_gibbs.coherence import ALONE, OFFSETS, OTHER, Neighbours
from pipeline.posterior.split_gibbs.kind_moves import (
    DARKEST,
    FREEDOM,
    jump_kinds,
    propose_jump,
    width,
)
from pipeline.posterior.split_gibbs.likelihood import point_materials
from pipeline.posterior.split_gibbs.lobes import BETWEEN, METALLIC, metallic_step, mix
from pipeline.posterior.split_gibbs.material_moves import (
    draw_offsets,
    draw_regions,
    propose_all,
    propose_spread,
)
from pipeline.posterior.split_gibbs.material_prior import (
    BLACK,
    BODY,
    COMMON,
    DIELECTRIC,
    DIELECTRIC_TINT,
    KIND_SHARE,
    METAL,
    METAL_TINT,
    SPREAD_PRIOR,
    TAIL,
    TINTS,
    log_joint_prior,
    log_prior,
    log_roughness,
    unlike_metal,
)
from pipeline.posterior.split_gibbs.metropolis import accepted
from pipeline.posterior.split_gibbs.state import RegionMaterials
from tests.seeds import numpy_rng

ROUGHNESS = (0.08, 0.12, 0.2, 0.3, 0.4, 0.55, 0.75, 1.0)
# of eight roughness steps: no rough metals
MOST_METALLIC = np.repeat([1.0, 0.2], 4)
# a model of two points, a region each, whose rows say nothing
SILENT = SimpleNamespace(
    data=SimpleNamespace(
        region=np.array([0, 1]),
        row_region=np.array([0, 1]),
        observed=np.array([[0.3, 0.2, 0.1], [0.6, 0.6, 0.6]]),
        clipped=np.zeros((2, 3), bool),
        rows=SimpleNamespace(point=np.array([0, 1])),
        bounds=np.arange(3),
        lobes=SimpleNamespace(
            roughness=ROUGHNESS, most_metallic=MOST_METALLIC, blurred=np.arange(8)[:, None]
        ),
        neighbours=Neighbours.none(2),
    ),
    precision=np.ones((2, 3)),
    point_values=lambda U, W, materials: np.zeros(2),
)


def lobes_seen() -> np.ndarray:
    """Four lobes (8, 4, 2, 3) of which each roughness makes something else of the light."""
    level = np.array([1.0, 0.1, 0.9, 0.2])[:, None, None]
    sharpness = 1 + 0.3 * np.sin(np.arange(8))[:, None, None, None]
    return np.broadcast_to(sharpness**2 * level**sharpness, (8, 4, 2, 3))


def between(metallic: np.ndarray, of_dielectric, of_metal) -> list:
    """Means and widths of two kinds at any metallic."""
    m = np.asarray(metallic)[..., None] if np.ndim(of_metal[0]) else np.asarray(metallic)
    return [(1 - m) * a + m * b for a, b in zip(of_dielectric, of_metal)]


def from_the_prior(count: int, rng) -> list[RegionMaterials]:
    """Draws of two regions, directly: Student's t as a normal over a chi, kinds from shares that
    the body draws, impossible colours and rough or unlikely metals thrown away.
    """
    root = np.linalg.cholesky((1 - COMMON) * np.eye(2) + COMMON)
    tried = 4 * count
    chi = np.sqrt(TAIL / rng.chisquare(TAIL, (2, tried, 1, 1)))
    student = lambda k: root @ rng.normal(size=(tried, 2, k)) * chi[k - 1]

    share = rng.dirichlet(BODY * KIND_SHARE, tried)
    m = METALLIC[(rng.random((tried, 2, 1)) > share.cumsum(1)[:, None]).sum(-1)]
    table = log_roughness(ROUGHNESS)[metallic_step(m.ravel())].reshape(tried, 2, 8)
    roughness = (table + rng.gumbel(size=table.shape)).argmax(-1)

    centre, width = between(m, DIELECTRIC, METAL)
    middle, reach = between(m, DIELECTRIC_TINT, METAL_TINT)
    bright = centre + width * student(1)[..., 0]
    color = np.exp(bright[..., None] + (middle + reach * student(2)) @ TINTS) - BLACK

    possible = (color > 0).all((1, 2)) & (color.max((1, 2)) < 0.98)
    possible &= (m <= MOST_METALLIC[roughness]).all(1)
    against = unlike_metal(np.maximum(color, 1e-9).reshape(-1, 3)).reshape(m.shape)
    possible &= rng.random(tried) < np.exp(-m * against).prod(1)
    kept = np.flatnonzero(possible)[:count]
    assert len(kept) == count
    return [RegionMaterials(color[k], np.full(2, 0.3), roughness[k], m[k]) for k in kept]


def figures(draws: list[RegionMaterials], edges: np.ndarray) -> np.ndarray:
    """Shares of one region's log brightness below `edges` (3,), share of metals and of bodies of
    one kind, mean roughness step over 8, share of times that both regions are on one side of the
    middle edge, tint.
    """
    log_color = np.log([t.color for t in draws])
    bright, metal = log_color.mean(2), np.array([t.metallic > 0.5 for t in draws])
    return np.array(
        [
            *(bright[:, :1] < edges).mean(0),
            metal[:, 0].mean(),
            (metal[:, 0] == metal[:, 1]).mean(),
            np.mean([t.roughness[0] for t in draws]) / 8,
            ((bright > edges[1]).sum(1) != 1).mean(),
            np.median(np.abs(log_color[:, 0] - bright[:, :1])),
        ]
    )


@pytest.mark.slow
def test_moves_leave_the_prior_as_it_is():
    """Every chain starts with a draw of the prior, and still is one after 8 jumps and 16 steps of
    wide moves: to six deviations of each of the eight figures, of Student's t as 32 parts tell the
    deviation, p < 1e-4.
    """
    rng = numpy_rng(0)
    many, first = from_the_prior(40_000, rng), from_the_prior(1250, rng)
    seen, offsets, step = lobes_seen(), np.zeros((3, 2), int), np.full(2, 0.5)

    def moved_on(t: RegionMaterials) -> RegionMaterials:
        at = offsets
        for _ in range(4):
            t, at = jump_kinds(SILENT, seen, t, at, 2, rng)
            t, _, _ = draw_regions(SILENT, seen, t, at, 4, rng, step)
        return t

    last = [moved_on(t) for t in first]
    moved = np.mean([np.abs(a.color - b.color).max() > 0.01 for a, b in zip(first, last)])
    assert moved > 0.9 and (step == 0.5).all()

    edges = np.quantile([np.log(t.color[0]).mean() for t in many], [0.25, 0.5, 0.75])
    exact = figures(many, edges)
    parts = [figures(many[k : k + 1250], edges) for k in range(0, 40_000, 1250)]
    deviation = np.std(parts, axis=0, ddof=1)
    assert deviation.max() < 0.02
    assert (np.abs(figures(last, edges) - exact) < 6 * deviation).all()


def some_materials(regions: int, rng) -> RegionMaterials:
    """Anything possible."""
    return RegionMaterials(
        rng.choice([0.02, 1.0]) * rng.uniform(0.02, 0.95, (regions, 3)),
        rng.uniform(0.05, 1.0, regions),
        rng.integers(8, size=regions),
        rng.choice(METALLIC, regions),
    )


def test_prior_of_the_materials_is_students_t():
    """Ratios of densities of three regions against scipy's: brightness of all regions together, the
    two directions of their tint together, kinds together, metallic within its kind, roughness and
    spread each by itself.
    """
    rng = numpy_rng(0)
    shape = (1 - COMMON) * np.eye(3) + COMMON

    def expected(t: RegionMaterials) -> float:
        log_color, m = np.log(t.color + BLACK), t.metallic
        centre, width = between(m, DIELECTRIC, METAL)
        middle, reach = between(m, DIELECTRIC_TINT, METAL_TINT)
        bright = stats.multivariate_t(centre, np.outer(width, width) * shape, df=TAIL)
        outer = np.outer(reach.ravel(), reach.ravel())
        tint = stats.multivariate_t(middle.ravel(), outer * np.kron(shape, np.eye(2)), df=TAIL)
        spread = stats.norm(*SPREAD_PRIOR).logpdf(np.log(t.spread)).sum()
        step = metallic_step(m)
        count = np.bincount(step, minlength=2)
        body = stats.dirichlet_multinomial(BODY * KIND_SHARE, 3).logpmf(count)
        in_order = body - gammaln(4) + gammaln(count + 1).sum()
        own = log_roughness(ROUGHNESS)[step, t.roughness]
        falls = np.log(t.color / (t.color + BLACK)).sum() - (m * unlike_metal(t.color)).sum()
        tints = tint.logpdf((log_color @ TINTS.T).ravel())
        return bright.logpdf(log_color.mean(1)) + tints + spread + in_order + own.sum() + falls

    draws = [some_materials(3, rng) for _ in range(50)]
    difference = [log_prior(t, ROUGHNESS) - expected(t) for t in draws]
    np.testing.assert_allclose(difference, difference[0], atol=1e-9)

    color = draws[0].color.copy()
    color[1, 2] = 0.985
    assert log_prior(replace(draws[0], color=color), ROUGHNESS) == -np.inf


def test_regions_are_accepted_one_after_the_other():
    """By Metropolis's rule on the prior of all colours together, times what speaks for each."""
    rng = numpy_rng(0)
    for seed in range(50):
        now, new, gain = some_materials(4, rng), some_materials(4, rng), rng.normal(size=4)
        found = accepted(now, new, gain, numpy_rng(seed))
        color, m = now.color.copy(), now.metallic.copy()
        for r, threshold in enumerate(np.log(numpy_rng(seed).random(4))):
            other_color, other_m = color.copy(), m.copy()
            other_color[r], other_m[r] = new.color[r], new.metallic[r]
            ratio = log_joint_prior(other_color, other_m) - log_joint_prior(color, m)
            assert found[r] == (threshold < gain[r] + ratio)
            if found[r]:
                color, m = other_color, other_m


def test_proposals_are_symmetric():
    """From a to b as often as from b to a, of roughness and metallic; steps of log colour and of
    spread as often up as down, whatever the place.
    """
    rng, n = numpy_rng(0), 200_000
    start = RegionMaterials(
        np.full((n, 3), 0.3), np.full(n, 0.3), rng.integers(8, size=n), rng.choice(METALLIC, n)
    )
    new = propose_all(start, 8, rng, np.full(n, 0.5))
    at = lambda t: t.roughness * len(METALLIC) + np.searchsorted(METALLIC, t.metallic)
    states = 8 * len(METALLIC)
    flow = np.bincount(at(start) * states + at(new), minlength=states**2).reshape(states, states)
    both = flow + flow.T
    often = np.triu(both >= 20, 1)
    assert often.sum() > 60
    z = (flow - flow.T)[often] / np.sqrt(both[often])
    assert abs((z**2).mean() - 1) < 5 * np.sqrt(2 / often.sum()) and np.abs(z).max() < 5

    steps = np.log(new.color / start.color)
    assert steps.std() > 0.2
    for column in (*steps.T, steps.sum(1)):
        assert stats.kstest(column[::2], -column[1::2]).pvalue > 1e-4 / 5
    moved = propose_spread(start, 8, rng, np.full(n, 0.5))
    spread = np.log(moved.spread / start.spread)
    assert spread.std() > 0.2 and stats.kstest(spread[::2], -spread[1::2]).pvalue > 1e-4 / 5


def test_jumps_keep_what_the_photos_show():
    """The colour of the other kind is drawn about the one that sends what the photo shows; its
    density there and back is Student's t of log colour.
    """
    rng, seen, offsets = numpy_rng(3), lobes_seen(), np.zeros((3, 2), int)
    sent_over_shown, kinds = [], []
    for _ in range(400):
        now = replace(some_materials(2, rng), metallic=rng.choice([0.0, 1.0], 2))
        new, back = propose_jump(SILENT, seen, now, offsets, rng)
        guess = [best_color(seen, t) for t in (now, new)]
        here, there = (
            stats.t.logpdf(np.log(t.color / g) / width(g), FREEDOM) - np.log(width(g))
            for t, g in zip((now, new), guess)
        )
        np.testing.assert_allclose(back, (here - there).sum(1), atol=1e-9)

        reached = (guess[1] > DARKEST) & (guess[1] < ALBEDO_MAX)
        ratio = sent(seen, new) / SILENT.data.observed
        sent_over_shown += ratio[reached].tolist()
        kinds += (new.metallic != now.metallic).tolist()
    assert abs(np.median(sent_over_shown) - 1) < 0.02 and 0.4 < np.mean(kinds) < 0.6
    assert np.quantile(np.abs(np.log(sent_over_shown)), 0.8) < 0.3


def lobes_at(seen: np.ndarray, t: RegionMaterials) -> tuple[np.ndarray, np.ndarray]:
    """U and W (2, 3) of two regions of one row each."""
    metallic = np.minimum(t.metallic, MOST_METALLIC[t.roughness])
    return mix(seen[t.roughness, :, np.arange(2)].transpose(1, 0, 2), metallic[:, None])


def sent(seen: np.ndarray, t: RegionMaterials) -> np.ndarray:
    """What they send to the cameras, (2, 3)."""
    U, W = lobes_at(seen, t)
    return t.color * U + W


def best_color(seen: np.ndarray, t: RegionMaterials) -> np.ndarray:
    """The colours (2, 3) with which they send what the photo shows, as far as there are such."""
    U, W = lobes_at(seen, t)
    return np.clip((SILENT.data.observed - W) / U, DARKEST, ALBEDO_MAX)


class Two:
    """Two regions of 60 points; a point's log-likelihood falls with the distance of its roughness
    step from a target, or says nothing.
    """

    def __init__(self, targets, sharpness, neighbours=None):
        steps = 8 * BETWEEN
        self.data = SimpleNamespace(
            region=np.repeat([0, 1], 60),
            rows=SimpleNamespace(point=np.arange(120)),
            bounds=np.arange(121),
            lobes=SimpleNamespace(
                roughness=range(steps),
                most_metallic=np.ones(steps),
                blurred=np.arange(steps)[:, None],
            ),
            neighbours=neighbours or Neighbours.none(120),
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
    """Offsets (3, 120), beginning with none."""
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
    offset = drawn_offsets(targets, 10.0, numpy_rng(0))
    assert (offset[0, :60] == 0).all()
    assert np.abs(offset[0, 60:] - (targets[60:] - 4 * BETWEEN)).mean() < 0.1


def test_points_without_photos_follow_their_own_odds():
    """Points that know nothing of each other: every label as often as its prior says, to five
    deviations.
    """
    rng = numpy_rng(1)
    drawn = np.concatenate([drawn_offsets(np.zeros(120), 0.0, rng) for _ in range(60)], 1)
    for row, labels in enumerate(OFFSETS):
        share = (drawn[row][:, None] == labels).mean(0)
        expected = np.exp(ALONE[row]) / np.exp(ALONE[row]).sum()
        deviation = np.sqrt(expected * (1 - expected) / drawn.shape[1])
        assert (np.abs(share - expected) < 5 * deviation).all()


def test_offsets_stay_among_the_roughnesses_there_are_and_turn_kinds():
    data = Two(np.zeros(120), 0.0).data
    far = np.stack([np.full(120, 99), np.full(120, OTHER), np.zeros(120, int)])
    roughness, metallic = point_materials(data, plain_regions(), far)
    assert (roughness == 8 * BETWEEN - 1).all() and (metallic == 1).all()
    half = np.stack([np.zeros(120, int), np.arange(120) % 2, np.zeros(120, int)])
    assert (point_materials(data, plain_regions(), half)[1] == np.arange(120) % 2).all()
