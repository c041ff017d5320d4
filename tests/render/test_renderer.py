import numpy as np
import pytest

from pipeline.render.metrics import render_view
from pipeline.render.renderer import Explanation, Renderer


def explanation(texture=8, rows=8, seed=0, roughness=0.5, metallic=0.2):
    rng = np.random.default_rng(seed)
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
    rng = np.random.default_rng(seed)
    o = rng.normal(size=(n, 3))
    o = 3 * o / np.linalg.norm(o, axis=1, keepdims=True)
    d = rng.uniform(-0.25, 0.25, (n, 3)) - o
    return o, d / np.linalg.norm(d, axis=1, keepdims=True)


def test_picture_is_linear_in_the_light(renderer):
    """R(2 x + y) = 2 R(x) + R(y) with the same paths; light sampling follows the light, so up to
    Monte-Carlo error.
    """
    x, y = explanation(seed=1), explanation(seed=2)
    y.base_color[:] = x.base_color
    both = Explanation(2 * x.light + y.light, x.base_color, x.roughness, x.metallic)
    o, d = rays_at_ball(20000)
    picture = []
    for e in (x, y, both):
        renderer.set(e)
        picture.append(renderer.radiance(o, d, 7).mean(0))
    assert np.allclose(picture[2], 2 * picture[0] + picture[1], rtol=0.01)


def test_scaling_the_light_scales_the_picture_exactly(renderer):
    x = explanation()
    o, d = rays_at_ball(500)
    renderer.set(x)
    one = renderer.radiance(o, d, 3)
    renderer.set(Explanation(4 * x.light, x.base_color, x.roughness, x.metallic))
    assert np.allclose(renderer.radiance(o, d, 3), 4 * one, rtol=1e-4)


def test_white_furnace(renderer):
    """A white rough ball under constant light of 1: Disney's diffuse lobe gains about 5 % at
    roughness 1, no more.
    """
    ones = np.ones((8, 8), np.float32)
    x = Explanation(np.ones((8, 16, 3), np.float32), np.ones((8, 8, 3), np.float32), ones, 0 * ones)
    renderer.set(x)
    L = renderer.radiance(*rays_at_ball(20000), 1)
    assert 0.95 < L.mean() < 1.08


@pytest.mark.slow
@pytest.mark.parametrize(
    "part, at",
    [("light", (2, 5, 1)), ("base_color", (4, 4, 0)), ("roughness", (4, 4)), ("metallic", (4, 4))],
)
def test_gradient_agrees_with_finite_differences(renderer, part, at):
    """d/dp of sum (A - y)(B - y) / n, whose expectation is the squared error, against central
    differences.
    """
    x = explanation()
    n, spp = 4000, 64
    o, d = (np.broadcast_to(v, (spp, n, 3)) for v in rays_at_ball(n))
    y = np.full((n, 3), 0.2)
    loss = lambda L: (float(((L - y) ** 2).mean()), 2 * (L - y) / L.size)
    step = {"light": 0.4, "base_color": 0.15, "roughness": 0.1, "metallic": 0.15}[part]
    values, total = [], 0.0
    for sign in (1, -1):
        moved = Explanation(*(v.copy() for v in vars(x).values()))
        value = getattr(moved, part)
        if part == "light":
            value[at] += sign * step
        else:
            value += sign * step  # a whole map: one texel's effect drowns in noise
        renderer.set(moved)
        paths = np.mean([renderer.radiance(o[k], d[k], 11 + k) for k in range(spp)], 0)
        values.append(((paths - y) ** 2).mean())
    g = getattr(renderer.gradient(x, o, d, n, loss, 5), part)
    total = g[at] if part == "light" else g.sum()
    expected = (values[0] - values[1]) / (2 * step)
    assert np.isclose(total, expected, rtol=0.15, atol=2e-5), (total, expected)


def test_fresh_seeds_give_fresh_noise_and_equal_seeds_equal_pictures(renderer):
    """The second defect of the published code: the same Monte-Carlo seed in every step."""
    renderer.set(explanation())
    o, d = rays_at_ball(300)
    assert (renderer.radiance(o, d, 1) == renderer.radiance(o, d, 1)).all()
    assert not (renderer.radiance(o, d, 1) == renderer.radiance(o, d, 2)).all()


def test_hard_cases_give_no_nan(renderer):
    """Black albedo, mirror-like and fully rough metal, a light with one bright pixel, grazing
    rays.
    """
    x = explanation()
    x.base_color[:4] = 0
    x.roughness[:], x.metallic[:] = 0.08, 1
    x.light[2, 3] = 1e4
    o, d = rays_at_ball(3000)
    stack = np.broadcast_to(o, (2, 3000, 3)), np.broadcast_to(d, (2, 3000, 3))
    g = renderer.gradient(x, *stack, 3000, lambda L: (float((L**2).mean()), 2 * L / L.size), 9)
    assert all(np.isfinite(v).all() for v in vars(g).values())


def test_camera_and_texture_orientation(ball, ring):
    """A red upper half in texture space v > 0.5 is where the mesh's v > 0.5 is, as seen by our own
    projection.
    """
    from pipeline.render.observe import Tracer

    renderer = Renderer(ball / "mesh_uv.ply", 64, 8, 2)
    ones = np.ones((64, 64), np.float32)
    color = np.full((64, 64, 3), 0.05, np.float32)
    color[:32, :, 0] = 0.9  # row 0 is v = 1
    view = ring(4, 48)[0]
    picture = render_view(
        renderer, Explanation(np.ones((8, 16, 3), np.float32), color, ones, 0 * ones), view, 4
    )
    rows, columns = np.mgrid[6:42, 6:42].reshape(2, -1)
    uv, _, hit = Tracer(ball / "mesh_uv.ply").hit(
        *view.rays(np.stack([columns + 0.5, rows + 0.5], -1))
    )
    clear = hit & (np.abs(uv[:, 1] - 0.5) > 0.06)
    red = picture[rows, columns, 0] > 2 * picture[rows, columns, 1]
    assert clear.sum() > 200 and (red == (uv[:, 1] > 0.5))[clear].mean() > 0.93
