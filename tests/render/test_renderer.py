from dataclasses import replace

import numpy as np
import pytest

from pipeline.render.observe import Tracer
from pipeline.render.renderer import (
    NO_HIGHLIGHT,
    Explanation,
    Renderer,
    head_on,
    ior_of,
    resized_metallic,
)
from tests.render.pictures import render_view
from tests.seeds import numpy_rng, seeded


def explanation(texture=8, rows=8, seed=0, roughness=0.5, metallic=0.2):
    rng = numpy_rng(seed)
    full = lambda v: np.full((texture, texture), v, np.float32)
    return Explanation(
        rng.uniform(0.2, 1.5, (rows, 2 * rows, 3)).astype(np.float32),
        rng.uniform(0.2, 0.8, (texture, texture, 3)).astype(np.float32),
        full(roughness),
        full(metallic),
    )


@pytest.fixture(scope="module")
def renderer(ball):
    return Renderer(ball / "mesh_uv.ply", 8, 8, 4)


def rays_at_ball(n, seed=0):
    """Origins and directions (n, 3): from all around, at points near the middle."""
    rng = numpy_rng(seed)
    origins = rng.normal(size=(n, 3))
    origins = 3 * origins / np.linalg.norm(origins, axis=1, keepdims=True)
    directions = rng.uniform(-0.25, 0.25, (n, 3)) - origins
    return origins, directions / np.linalg.norm(directions, axis=1, keepdims=True)


def test_picture_is_linear_in_the_light(renderer):
    """R(2 x + y) = 2 R(x) + R(y) with the same paths; light sampling follows the light, so up to
    Monte-Carlo error.
    """
    one = explanation(seed=1)
    other = replace(one, light=explanation(seed=2).light)
    both = replace(one, light=2 * one.light + other.light)
    rays = rays_at_ball(20000)

    mean = []
    for lit in (one, other, both):
        renderer.set(lit)
        mean.append(renderer.radiance(*rays, seeded(7)).mean(0))
    assert np.allclose(mean[2], 2 * mean[0] + mean[1], rtol=0.01)


@pytest.mark.parametrize("spp, chunk", [(8, 900), (7, 900), (8, 100), (1, 900), (8, 1 << 19)])
def test_a_mean_takes_every_path_of_every_pixel_once(renderer, monkeypatch, spp, chunk):
    """However many paths are traced together: pixel k of ray set p is worth k + p / 10 here."""
    pixels, made = 300, []

    def rays(rng):
        made.append(len(made))
        origins = np.stack([np.arange(pixels), np.full(pixels, made[-1]), np.zeros(pixels)], 1)
        return origins, origins

    def radiance(origins, directions, seed):
        return np.repeat((origins[:, 0] + origins[:, 1] / 10)[:, None], 3, 1)

    monkeypatch.setattr(renderer, "radiance", radiance)
    found = renderer.mean_radiance(rays, spp, seeded(1), chunk)
    assert len(made) == spp
    assert np.allclose(found[:, 0], np.arange(pixels) + np.mean(made) / 10)


def test_without_a_highlight_a_black_thing_is_black(renderer):
    """Within half a percent of the highlight, which Mitsuba leaves; and it comes back."""
    rays = rays_at_ball(2000)
    black = explanation(metallic=0.0, roughness=0.3)
    black = replace(black, base_color=0 * black.base_color)

    def picture(x):
        renderer.set(x)
        return renderer.radiance(*rays, seeded(3))

    glossy = picture(black)
    assert glossy.mean() > 0.01
    assert picture(replace(black, ior=NO_HIGHLIGHT)).mean() < 0.005 * glossy.mean()
    assert np.array_equal(picture(black), glossy)


@pytest.mark.parametrize("ior, reflectance", [(1.0, 0.0), (1.5, 0.04), (1.33, 0.02)])
def test_reflectance_head_on_is_fresnels(ior, reflectance):
    assert head_on(ior) == pytest.approx(reflectance, abs=2e-4)
    assert ior_of(head_on(ior)) == pytest.approx(ior)


def test_an_explanation_is_what_was_saved(tmp_path):
    saved = replace(explanation(), ior=1.2)
    saved.save(tmp_path)
    loaded = Explanation.load(tmp_path)
    assert loaded.ior == 1.2 and loaded.copy().ior == 1.2
    for name in ("light", "base_color", "roughness", "metallic"):
        assert np.array_equal(getattr(loaded, name), getattr(saved, name))
    (tmp_path / "ior.json").unlink()  # as runs before there was one left it
    assert Explanation.load(tmp_path).ior == 1.5


def test_metal_stays_metal_at_another_size():
    """A disc keeps its area, larger and smaller; a metallic between 0 and 1 runs over."""
    at = np.stack(np.mgrid[:48, :48], -1) + 0.5
    disc = (((at - 24) ** 2).sum(-1) < 15**2).astype(np.float32)
    for side in (16, 192):
        found = resized_metallic(disc, side)
        assert found.dtype == np.float32 and set(np.unique(found)) == {0.0, 1.0}
        assert abs(found.mean() - disc.mean()) < 0.02
        soft = resized_metallic(0.9 * disc, side)
        assert ((soft > 0.01) & (soft < 0.89)).any()


def test_scaling_the_light_scales_the_picture_exactly(renderer):
    plain = explanation()
    rays = rays_at_ball(500)
    renderer.set(plain)
    once = renderer.radiance(*rays, seeded(3))
    renderer.set(replace(plain, light=4 * plain.light))
    assert np.allclose(renderer.radiance(*rays, seeded(3)), 4 * once, rtol=1e-4)


def test_white_furnace(renderer):
    """A white rough ball under constant light of 1: Disney's diffuse lobe gains about 5 % at
    roughness 1, no more.
    """
    ones = np.ones((8, 8), np.float32)
    white = np.ones((8, 8, 3), np.float32)
    renderer.set(Explanation(np.ones((8, 16, 3), np.float32), white, ones, 0 * ones))
    assert 0.95 < renderer.radiance(*rays_at_ball(20000), seeded(1)).mean() < 1.08


@pytest.mark.slow
@pytest.mark.parametrize(
    "part, at",
    [("light", (2, 5, 1)), ("base_color", (4, 4, 0)), ("roughness", (4, 4)), ("metallic", (4, 4))],
)
def test_gradient_agrees_with_finite_differences(renderer, part, at):
    """d/dp of sum (A - y)(B - y) / n, whose expectation is the squared error, against central
    differences.
    """
    plain = explanation()
    pixels = 4000
    spp = 64
    rays = rays_at_ball(pixels)
    photo = np.full((pixels, 3), 0.2)
    step = {"light": 0.4, "base_color": 0.15, "roughness": 0.1, "metallic": 0.15}[part]
    where = at if part == "light" else ...  # a whole map: one texel's effect drowns in noise

    losses = []
    for sign in (1, -1):
        moved = plain.copy()
        getattr(moved, part)[where] += sign * step
        renderer.set(moved)
        picture = np.mean([renderer.radiance(*rays, seeded(11 + k)) for k in range(spp)], 0)
        losses.append(((picture - photo) ** 2).mean())
    expected = (losses[0] - losses[1]) / (2 * step)

    loss = lambda L: (float(((L - photo) ** 2).mean()), 2 * (L - photo) / L.size)
    stacked = (np.broadcast_to(v, (spp, pixels, 3)) for v in rays)
    gradient = renderer.gradient(plain, *stacked, pixels, loss, seeded(5))
    found = getattr(gradient, part)[where].sum()
    assert np.isclose(found, expected, rtol=0.15, atol=2e-5), (found, expected)


def test_fresh_seeds_give_fresh_noise_and_equal_seeds_equal_pictures(renderer):
    """The second defect of the published code: the same Monte-Carlo seed in every step."""
    renderer.set(explanation())
    rays = rays_at_ball(300)
    assert (renderer.radiance(*rays, seeded(1)) == renderer.radiance(*rays, seeded(1))).all()
    assert not (renderer.radiance(*rays, seeded(1)) == renderer.radiance(*rays, seeded(2))).all()


@pytest.mark.slow
def test_hard_cases_give_no_nan(renderer):
    """Black albedo, mirror-like and fully rough metal, a light with one bright pixel, grazing
    rays.
    """
    hard = explanation(roughness=0.08, metallic=1)
    hard.base_color[:4] = 0
    hard.light[2, 3] = 1e4

    stacked = (np.broadcast_to(v, (2, 3000, 3)) for v in rays_at_ball(3000))
    loss = lambda L: (float((L**2).mean()), 2 * L / L.size)
    gradient = renderer.gradient(hard, *stacked, 3000, loss, seeded(9))
    assert all(np.isfinite(v).all() for v in vars(gradient).values())


def test_camera_and_texture_orientation(ball, ring):
    """A red upper half in texture space v > 0.5 is where the mesh's v > 0.5 is, as seen by our own
    projection.
    """
    renderer = Renderer(ball / "mesh_uv.ply", 64, 8, 2)
    ones = np.ones((64, 64), np.float32)
    color = np.full((64, 64, 3), 0.05, np.float32)
    color[:32, :, 0] = 0.9  # row 0 is v = 1
    view = ring(4, 48)[0]
    two_coloured = Explanation(np.ones((8, 16, 3), np.float32), color, ones, 0 * ones)
    picture = render_view(renderer, two_coloured, view, 4)

    rows, columns = np.mgrid[6:42, 6:42].reshape(2, -1)
    centres = np.stack([columns + 0.5, rows + 0.5], -1)
    uv, _, hit = Tracer(ball / "mesh_uv.ply").hit(*view.rays(centres))
    clear = hit & (np.abs(uv[:, 1] - 0.5) > 0.06)  # off the border between the colours
    red = picture[rows, columns, 0] > 2 * picture[rows, columns, 1]
    assert clear.sum() > 200 and (red == (uv[:, 1] > 0.5))[clear].mean() > 0.93


def test_no_rays_meet_nothing(ball):
    """A photo that does not show the object has none; Dr.Jit ended the process over them."""
    uv, cosine, hit = Tracer(ball / "mesh_uv.ply").hit(np.zeros((0, 3)), np.zeros((0, 3)))
    assert uv.shape == (0, 2) and cosine.shape == (0,) and hit.shape == (0,)
