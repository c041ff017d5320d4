"""Decisions against shapes and cameras whose answer is known in closed form."""

import numpy as np
import pytest

from pipeline.base.config import Fit, parse_scene
from pipeline.geometry.mesh_io import Mesh, load_mesh
from pipeline.posterior.choose.bounces import ALBEDO, path_vertices
from pipeline.posterior.choose.chosen import Chosen, chosen_scene, nothing_chosen
from pipeline.posterior.choose.decide import DECISIONS, choose
from pipeline.posterior.choose.fit_work import (
    FINEST,
    LEAST_PIXELS,
    LEAST_STEPS,
    LOOKS,
    fit_work,
)
from pipeline.posterior.choose.light_rows import light_rows
from pipeline.posterior.choose.texture_size import sampling_distance, texture_size, usual_side
from pipeline.render.observe import Tracer
from tests.conftest import sphere
from tests.seeds import numpy_rng


def saved(folder, mesh):
    from pipeline.geometry.mesh_io import save_mesh

    save_mesh(folder / "mesh.ply", mesh)
    return Tracer(folder / "mesh.ply").scene


def test_a_convex_object_needs_direct_light_only(tmp_path):
    ball = sphere(3)
    seen = ball.vertices * 1.0001, ball.normals
    depth, facts = path_vertices(saved(tmp_path, ball), ball, seen, 6, numpy_rng(0))
    assert depth == 2
    assert facts["hemisphere_blocked_by_the_object"]["95%"] == 0


@pytest.mark.slow
def test_inside_a_spherical_bowl_radiosity_is_known(tmp_path):
    """Every point of a sphere sees every area of it alike: of a bowl of which the part a remains,
    each inner point has K 1 = a, so E_k = (1 - a) (rho a)^k, and the d-th order and all after it
    are (rho a)^d of the total.
    """
    whole = sphere(4)
    inside = Mesh(whole.vertices, whole.faces[:, ::-1], -whole.normals)
    kept = inside.vertices[inside.faces].mean(1)[:, 1] < 0
    bowl = Mesh(inside.vertices, inside.faces[kept], inside.normals)
    face = bowl.vertices[bowl.faces].mean(1)
    seen = face, -face / np.linalg.norm(face, axis=1, keepdims=True)

    scene = saved(tmp_path, bowl)
    depth, facts = path_vertices(scene, bowl, seen, 8, numpy_rng(0))
    assert depth == 6  # .4^4 = .026 is more than TOLERANCE, .4^5 = .010 is less
    assert path_vertices(scene, bowl, seen, 3, numpy_rng(0))[0] == 3
    assert facts["hemisphere_blocked_by_the_object"]["mean"] == pytest.approx(0.5, abs=0.01)
    lost = facts["lost_share_by_max_depth"]
    for depth in (2, 3):
        assert lost[str(depth)] == pytest.approx((0.5 * ALBEDO) ** (depth - 1), rel=0.06)


def test_ground_sampling_distance_is_the_area_of_a_pixel_on_the_atlas(ball, toy, problem):
    """Against differences: texture coordinates of rays a hundredth of a pixel apart."""
    observations, step = problem.observations, 0.01
    surface = Tracer(ball / "mesh_uv.ply")
    everywhere = np.arange(len(observations))
    uv = [
        surface.hit(*observations._rays_at(everywhere, 0.5 + np.array(offset)))[0]
        for offset in ([0, 0], [step, 0], [0, step])
    ]
    across, down = uv[1] - uv[0], uv[2] - uv[0]
    area = np.abs(across[:, 0] * down[:, 1] - across[:, 1] * down[:, 0]) / step**2

    mesh = load_mesh(ball / "mesh_uv.ply")
    rng = numpy_rng(0)
    distance = sampling_distance(observations, problem.renderer.scene, mesh, rng)
    for share in (0.1, 0.5, 0.9):
        expected = np.quantile(np.sqrt(area), share)
        assert np.quantile(distance, share) == pytest.approx(expected, rel=0.05)


def test_a_texel_is_hardly_smaller_than_the_median_pixel():
    """At most .8 times as wide, and at least half of that, or three quarters."""
    side, facts = texture_size(np.full(100, 1 / 300), 1024)
    assert side == 384 and facts["texels_for_one_each_pixel"] == pytest.approx(300)
    assert texture_size(np.full(100, 1 / 310), 1024)[0] == 512
    assert texture_size(np.full(100, 1 / 3000), 1024)[0] == 1024  # never above the configured
    assert texture_size(np.full(100, 1 / 3000), 48)[0] == 48
    assert texture_size(np.full(100, 1.0), 1024)[0] == 16


def test_sides_of_textures_are_powers_of_two_or_three_quarters_of_one():
    sides = {usual_side(least) for least in np.linspace(1, 1024, 4000)}
    assert sides == {16, 24, 32, 48, 64, 96, 128, 192, 256, 384, 512, 768, 1024}
    for side in sides:
        assert usual_side(side) == side and usual_side(side + 0.1) > side


def test_the_fit_looks_at_every_texel_often_enough_and_not_more():
    """Steps go first, down to LEAST_STEPS, then pixels; never more than is configured."""
    configured = Fit(texture=256, pixels=8192, steps=300)
    of_side = lambda side: np.full(100, 1 / side)
    work, facts = fit_work(of_side(64), configured)
    assert (work["texture"], work["steps"]) == (64, LEAST_STEPS)
    assert facts["looks_at_a_texel"] == pytest.approx(LOOKS, rel=0.01)
    assert facts["texels_for_one_each_pixel"] == pytest.approx(64)
    work, facts = fit_work(of_side(16), configured)
    assert work == {"texture": 16, "steps": LEAST_STEPS, "pixels": LEAST_PIXELS}
    assert facts["looks_at_a_texel"] > LOOKS
    # pixels may be narrower than texels by a factor of two, and never wider
    assert fit_work(of_side(127), configured)[0]["texture"] == 64
    finest = fit_work(of_side(FINEST), configured)[0]
    assert finest["texture"] == FINEST
    assert fit_work(of_side(250), configured)[0] == fit_work(of_side(3000), configured)[0] == finest
    slow = configured.model_copy(update={"pixels": 1500})
    assert fit_work(of_side(3000), slow)[0]["steps"] == 300
    few = configured.model_copy(update={"pixels": 100, "steps": 20})
    assert fit_work(of_side(16), few)[0] == {"texture": 16, "steps": 20, "pixels": 100}


def test_rows_follow_the_blur_of_reflections():
    """exp(-(2 sigma h)^2 / 2) of a detail of h periods is left: at the rows that are chosen less
    than it takes to see it, at half of them more.
    """
    for spread in (0.02, 0.04, 0.08, 0.2):
        rows, facts = light_rows(spread, 64)
        left = lambda h, sigma=spread: np.exp(-((2 * sigma * h) ** 2) / 2)
        assert rows == 64 or left(rows) <= facts["visible_contrast"]
        assert rows == 16 or left(rows / 2) > facts["visible_contrast"]
    assert light_rows(0.0, 32)[0] == 32 and light_rows(10.0, 8)[0] == 8


class Unread:
    """Evidence that must not be looked at."""

    def __getattr__(self, name):
        raise AssertionError(name)


@pytest.mark.parametrize(
    "own",
    [
        {
            "choose": {"enabled": True}
            | dict.fromkeys(("texture", "bounces", "light", "fit"), "keep")
        },
        {
            "choose": {"enabled": True},
            "refine": {"texture": 512},
            "render": {"max_depth": 3},
            "sample": {"light": 16},
            "fit": {"steps": 200},
        },
    ],
)
def test_what_the_user_settles_is_kept(own, tmp_path):
    """By `keep`, or by setting the thing itself."""
    scene = parse_scene({"photos": "x"} | own, "c.yaml")
    result = choose(Unread(), scene)
    assert result["settings"] == {}
    Chosen(result["settings"]).save(tmp_path)
    assert chosen_scene(scene, tmp_path) == scene


def test_auto_overrules_a_setting_of_ones_own():
    own = {"photos": "x", "refine": {"texture": 512}, "choose": {"texture": "auto"}}
    assert parse_scene(own, "c.yaml").choose.texture == "auto"


def test_nothing_is_chosen_where_the_stage_is_off(tmp_path):
    """As in `reference`; every decision says so, and every one can be kept or asked for by
    name.
    """
    assert parse_scene({"photos": "x"}, "c.yaml").choose.enabled
    scene = parse_scene({"photos": "x", "preset": "reference"}, "c.yaml")
    assert not scene.choose.enabled and set(nothing_chosen()["decisions"]) == set(DECISIONS)
    assert set(DECISIONS) == set(scene.choose.model_dump()) - {"enabled"}
    Chosen(nothing_chosen()["settings"]).save(tmp_path)
    assert chosen_scene(scene, tmp_path) == scene
