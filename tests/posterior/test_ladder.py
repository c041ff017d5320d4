"""How much gloss and metal a body keeps, on photos that are rendered from known ones."""

from copy import copy
from dataclasses import replace

import numpy as np
import pytest

from pipeline.base.config import Refine
from pipeline.base.progress import Bar
from pipeline.posterior.ladder import (
    BARE,
    CHANCE,
    Jury,
    bodies,
    climb,
    climbed,
    of_a_body,
    rungs,
    without_highlight,
)
from pipeline.posterior.left_out import folds, gain, residuals, squared_error, surely
from pipeline.posterior.problem import Problem
from pipeline.posterior.refine import refine, shading_by_color, solve_base_color, units
from pipeline.posterior.textures import gather
from tests.seeds import numpy_rng

RED = [0.6, 0.15, 0.1]


def photographed(problem, truth, seed=0):
    """The problem with photos of `truth` from the same cameras, 128 paths for each pixel."""
    observations = copy(problem.observations)
    everywhere = np.arange(len(observations))
    problem.renderer.set(truth)
    rays = lambda rng: observations.rays(everywhere, rng)
    observations.rgb = problem.renderer.mean_radiance(rays, 128, seed)
    observations.clipped = np.zeros(observations.rgb.shape, bool)
    return Problem(observations, problem.renderer, problem.roughness_min)


def solve(problem, explanation):
    return solve_base_color(problem, explanation, 4000, numpy_rng(0))[0]


def found(problem, explanation, seed=1):
    rng = numpy_rng(seed)
    return climb(
        problem, explanation, folds(problem.observations, rng), shading_by_color, 4000, rng
    )


@pytest.fixture(scope="module")
def two_bodies(toy):
    """The ball grey left of the atlas' middle and red right of it: (truth, its body map)."""
    truth = toy[1]
    color = np.full_like(truth.base_color, 0.5)
    color[:, color.shape[1] // 2 :] = RED
    return replace(truth, base_color=color), (color[..., 2] < 0.3).astype(int)


def with_gloss(truth, body, roughness, metallic):
    """Roughness and metallic of either body."""
    pick = lambda pair: np.array(pair, np.float32)[body]
    return replace(truth, roughness=pick(roughness), metallic=pick(metallic))


def test_a_matt_thing_keeps_no_metal_and_no_map_whatever_was_drawn(problem, two_bodies):
    """The draw says gloss and metal in patches; the photos show neither. (A roughness of .6 and one
    of 1 hardly differ here: either may be taken, of the surface or of a body.)
    """
    truth, body = two_bodies
    matt = with_gloss(truth, body, (1.0, 1.0), (0.0, 0.0))
    patches = numpy_rng(0).random(truth.roughness.shape) < 0.3
    drawn = replace(
        matt,
        roughness=np.where(patches, 0.2, 0.6).astype(np.float32),
        metallic=patches.astype(np.float32),
    )
    simple, maps, facts = found(photographed(problem, matt), drawn)
    numbers = {"matt", "one gloss", "gloss of a body"}
    assert {body["chosen"] for body in facts["bodies"]} <= numbers and not maps.any()
    assert (simple.metallic == 0).all() and simple.roughness.min() > 0.4


def test_gloss_that_photos_show_is_kept_as_one_number(problem, two_bodies):
    """The draw has a map, wrong by up to twice. That the photos ask for gloss is certain. The map
    is taken by chance on some seeds, as often as CHANCE says; on none does it gain as it would by
    chance once in ten thousand.
    """
    truth, body = two_bodies
    glossy = with_gloss(truth, body, (0.15, 0.15), (0.0, 0.0))
    wrong = 2 ** numpy_rng(0).uniform(-1, 1, truth.roughness.shape)
    drawn = replace(glossy, roughness=(glossy.roughness * wrong).astype(np.float32))
    simple, maps, facts = found(photographed(problem, glossy), drawn)

    certain, clear = (surely(chance, np.arange(facts["blocks"])) for chance in (1e-4, CHANCE))
    to_gloss, *higher = facts["surface"]["tried"]
    assert to_gloss["gain"] > certain * to_gloss["standard_error"]
    map_ = facts["rungs"].index("gloss map")
    (to_map,) = [step for step in higher if step["to"] == map_]
    assert to_map["gain"] < certain * to_map["standard_error"]
    taken = to_map["gain"] > clear * to_map["standard_error"]
    assert (facts["surface"]["chosen"] == "gloss map") == taken
    one = gather(np.where(maps, np.nan, simple.roughness), problem.observations.uv)
    one = one[np.isfinite(one)]
    assert len(one) == 0 or (np.abs(one - 0.15) < 0.03).mean() > 2 / 3


def test_metal_that_photos_show_stays(problem, two_bodies):
    """Its reflections move with the view, as no base colour does. (A small body as above.)"""
    truth, body = two_bodies
    metal = with_gloss(truth, body, (0.25, 0.25), (1.0, 1.0))
    simple, _, facts = found(photographed(problem, metal), metal)
    assert facts["surface"]["chosen"] in ("one metal", "as drawn")
    uv = problem.observations.uv
    assert (gather(simple.metallic, uv) > 0.5).mean() > 2 / 3


@pytest.mark.parametrize("ior", [1.0, 1.5])
def test_a_thing_has_a_highlight_where_photos_show_one(problem, two_bodies, ior):
    """Matt and dark under a lamp, with no highlight at all and with that of a rough dielectric."""
    truth, body = two_bodies
    light = np.full_like(truth.light, 0.05)
    light[len(light) // 4, 0] = 300.0
    truth = replace(truth, light=light, base_color=0.06 * truth.base_color)
    matt = with_gloss(truth, body, (1.0, 1.0), (0.0, 0.0))
    shown = matt if ior == 1.5 else without_highlight(matt, body < 0)
    simple, maps, facts = found(photographed(problem, shown), matt)
    tried = facts[BARE]
    assert abs(tried["gain"]) > 3 * tried["standard_error"]
    assert tried["chosen"] == (tried["gain"] > 0) == (ior == 1.0)
    assert simple.ior == ior and not maps.any()


def test_metal_keeps_its_highlight_where_the_rest_has_none(two_bodies):
    truth, body = two_bodies
    x = with_gloss(truth, body, (0.2, 0.3), (1.0, 0.0))
    bare = without_highlight(x, x.metallic > 0)
    assert (bare.metallic == x.metallic).all()
    assert bare.ior == 1.0 and set(np.unique(bare.roughness)) == {np.float32(0.2), 0.5}


def test_where_gloss_is_asked_for_none_is_not_tried(problem, two_bodies):
    truth, body = two_bodies
    glossy = with_gloss(truth, body, (0.15, 0.15), (0.0, 0.0))
    simple, _, facts = found(photographed(problem, glossy), glossy)
    assert simple.ior == 1.5 and BARE not in facts


def test_rungs_begin_matt_and_end_as_drawn(two_bodies):
    truth, body = two_bodies
    drawn = with_gloss(truth, body, (0.5, 0.2), (0.0, 1.0))
    uv = numpy_rng(0).random((500, 2))
    steps = {rung.name: rung for rung in rungs(drawn, body, uv)}
    # one body of dielectric: its gloss is the surface's
    assert list(steps) == ["matt", "one gloss", "gloss map", "one metal", "as drawn"]
    assert all((steps[name].metallic == 0).all() for name in list(steps)[:3])
    for name, roughness in (("one gloss", 0.5), ("one metal", 0.2)):
        assert np.ptp(steps[name].roughness) == 0
        assert steps[name].roughness[0, 0] == pytest.approx(roughness)


def test_a_rung_that_is_no_other_than_a_simpler_one_is_not_tried(two_bodies):
    truth, body = two_bodies
    uv, names = numpy_rng(0).random((500, 2)), lambda *at: [rung.name for rung in rungs(*at)]
    two = with_gloss(truth, body, (0.5, 0.2), (0.0, 0.0))
    one = with_gloss(truth, body, (0.5, 0.5), (0.0, 0.0))
    metal = with_gloss(truth, body, (0.2, 0.2), (1.0, 1.0))
    assert names(two, body, uv) == ["matt", "one gloss", "gloss of a body"]
    assert names(two, np.zeros_like(body), uv) == ["matt", "one gloss", "gloss map"]
    assert names(one, body, uv) == ["matt", "one gloss"]
    assert names(metal, body, uv) == ["matt", "one gloss", "one metal"]


def test_bodies_follow_colour_and_not_brightness_alone(two_bodies):
    """Shading that is left over in a base colour makes no body."""
    truth, body = two_bodies
    ramp = np.linspace(0.8, 1.25, body.shape[0])[:, None, None]
    uv = numpy_rng(0).random((4000, 2))
    label = bodies((truth.base_color * ramp).astype(np.float32), uv, numpy_rng(0))
    inner = np.abs(np.arange(body.shape[1]) - body.shape[1] // 2) > 4  # beside the soft border
    for one in (0, 1):
        assert len(np.unique(label[:, inner][body[:, inner] == one])) == 1
    assert label[0, 0] != label[0, -1]


def test_whole_photos_judge_and_make_no_colour(problem):
    observations = problem.observations
    parts = folds(observations, numpy_rng(0))
    assert len(parts) == 4  # two of eight photos, a fifth, rounded: all judge once
    assert sorted(np.concatenate([np.unique(observations.view[p.judged]) for p in parts])) == [
        *range(8)
    ]
    for part in parts:
        judging = set(observations.view[part.judged])
        assert len(judging) == part.photos == 2
        assert not judging & set(observations.view[part.kept])
        key = np.c_[observations.view, observations.pixel // 4][part.judged]
        assert len({(*k,) for k in key}) == len(np.unique(part.block))
        kept = problem.with_pixels(part.kept).observations
        assert (kept.rgb == observations.rgb[part.kept]).all() and len(kept) == len(part.kept)
    blocks = [set(part.block) for part in parts]
    assert sum(map(len, blocks)) == len(set.union(*blocks))


def jury(problem, parts):
    return Jury(problem, parts, shading_by_color, 4000, 7)


def test_photos_that_judge_leave_no_trace_in_the_colours_that_they_judge(problem, toy):
    """What light gives is traced once for all folds; what photos show is not shared."""
    parts = folds(problem.observations, numpy_rng(0))
    spoilt = copy(problem)
    spoilt.observations = copy(problem.observations)
    spoilt.observations.rgb = problem.observations.rgb.copy()
    out = np.unique(problem.observations.view[parts[0].judged])
    colors_of_first = lambda of, parts: next(jury(of, parts).solved(toy[1])).base_color
    spoilt.observations.rgb[np.isin(problem.observations.view, out)] = 0.9
    colours = [colors_of_first(of, parts) for of in (problem, spoilt)]
    assert (colours[0] == colours[1]).all()
    by_itself = [colors_of_first(of, parts[1:]) for of in (problem, spoilt)]
    assert np.abs(by_itself[0] - by_itself[1]).max() > 0.1


def test_a_jury_says_what_every_fold_would_say_by_itself(problem, toy):
    parts = folds(problem.observations, numpy_rng(0))
    together = jury(problem, parts).errors(toy[1])
    by_itself = np.concatenate([jury(problem, [part]).errors(toy[1]) for part in parts])
    assert len(together) == sum(len(part.judged) for part in parts)
    # paths for the colours differ, those that judge do not: what is left is the colours' noise
    assert np.abs(np.mean(together) - np.mean(by_itself)) < 0.1 * np.mean(np.abs(by_itself))


def test_all_explanations_are_judged_by_the_same_paths(problem, toy):
    """So that noise does not choose between two that are alike."""
    one = jury(problem, folds(problem.observations, numpy_rng(0)))
    errors = [one.errors(toy[1]) for _ in range(2)]
    assert (errors[0] == errors[1]).all()


def test_many_photos_judge_in_one_fold(problem):
    """A fifth of forty is as many as need to judge."""
    many = copy(problem.observations)
    many.view = np.arange(len(many)) % 40
    (fold,) = folds(many, numpy_rng(0))
    assert fold.photos == 8


def test_three_photos_judge_nothing(problem, start):
    few = problem.with_pixels(np.flatnonzero(problem.observations.view < 3))
    assert folds(few.observations, numpy_rng(0)) == []
    settings = Refine(steps=0, pixels=100, texture=32, shading_pixels=1000, gloss="tested")
    with Bar("refine", units(settings)) as bar:
        _, facts = refine(few, start[0], settings, 0, bar)
    assert facts["gloss"] == {"why": "too few photos to judge them by"}


def test_a_rung_must_gain_two_standard_errors():
    """Blocks of one pixel whose errors fall by 3 and rise by 1 in turn, from 9: 400 are clear, 14
    are not, and of 6 nothing is said. The first two rungs are equally simple: there 14 do.
    """
    for count, higher, expected in ((400, 2, 2), (14, 2, 0), (6, 2, 0), (14, 1, 1)):
        start = np.full(count, 9.0)
        better = start - np.where(np.arange(count) % 2, -1.0, 3.0)
        errors = [start] * higher + [better]
        stands, tried = climbed(errors, np.arange(count))
        of_all = 4 / 36 if count >= 10 else 0
        assert tried[-1]["gain"] == pytest.approx(of_all)
        assert stands == expected
        clear = tried[-1]["gain"] > 2.1 * tried[-1]["standard_error"]
        assert clear == (expected == 2)


def test_a_gain_is_chance_once_in_forty_however_many_rungs_are_tried():
    """Of errors with nothing in them but noise, by blocks few and many."""
    rng = numpy_rng(0)
    for blocks in (12, 200):
        left = sum(
            of_a_body([*rng.normal(10, 1, (6, blocks))], np.arange(blocks), 0)[0] != 0
            for _ in range(2000)
        )
        assert left < 2000 * 0.023 + 4 * np.sqrt(2000 * 0.023)
    assert surely(0.023, np.arange(10**6)) == pytest.approx(2, abs=0.01)


def test_a_body_leaves_the_surfaces_rung_only_where_it_gains_clearly():
    """Up or down; and where it has too few pixels to say, it stays."""
    low, high = np.full(40, 1.0), np.full(40, 2.0)
    block = np.arange(40)
    assert of_a_body([low, high, high], block, 2)[0] == 0
    assert of_a_body([high, high, low], block, 0)[0] == 2
    assert of_a_body([low, low, low], block, 1)[0] == 1
    assert of_a_body([low, high, high], block // 10, 2)[0] == 2


def test_gain_counts_blocks_and_not_pixels():
    """Errors that whole blocks share: k copies of a pixel say no more than one."""
    simple, rich = np.tile([3.0, 1.0, 2.0], 5), np.tile([1.0, 2.0, 1.0], 5)
    block = 4 + 3 * np.arange(15)
    share, error = gain(simple, rich, block)
    assert share == pytest.approx((simple - rich).sum() / simple.sum())
    assert error == pytest.approx(np.sqrt(15) * np.std(simple - rich, ddof=1) / simple.sum())

    copies = [np.repeat(values, 50) for values in (simple, rich, block)]
    assert gain(*copies) == (pytest.approx(share), pytest.approx(error))
    assert gain(rich, rich, block) == gain(simple, rich, block // 100) == (0, 0)


def test_error_is_that_of_a_score_and_free_of_the_paths_noise(problem, toy):
    """Of the truth with photos of 64 paths a pixel nothing is left but their noise: far less than
    the square of one picture's own.
    """
    truth = toy[1]
    everywhere = np.arange(len(problem.observations))
    error = squared_error(residuals(photographed(problem, truth), truth, everywhere, 3))
    darker = replace(truth, light=0.5 * truth.light)
    assert (
        abs(error.mean()) < 0.02 * squared_error(residuals(problem, darker, everywhere, 3)).mean()
    )


def test_refinement_says_what_it_chose(problem, start):
    settings = Refine(steps=2, pixels=300, texture=32, shading_pixels=8000, gloss="tested")
    with Bar("refine", units(settings)) as bar:
        refined, facts = refine(problem, start[0], settings, 0, bar)
    chosen = {body["chosen"] for body in facts["gloss"]["bodies"]}
    assert chosen <= set(facts["gloss"]["rungs"])
    if not chosen & {"gloss map", "as drawn", "one metal"}:
        assert (refined.metallic == 0).all()
    if chosen <= {"matt", "one gloss"}:
        assert len(np.unique(refined.roughness.round(4))) <= 2
