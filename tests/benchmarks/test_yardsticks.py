"""The study's yardsticks, on a ball of two colours in lights whose means are known."""

import numpy as np
import pytest

from benchmarks.study.yardstick_tables import losers, table
from benchmarks.study.yardsticks import matt, mean_radiance, unlit_pictures
from pipeline.render.observe import Tracer
from pipeline.render.renderer import Renderer
from pipeline.report.score import rendered
from pipeline.report.truth import Picture, Relit, TrueView, Truth

SIZE = 32


@pytest.fixture(scope="module")
def truth(ball, ring) -> Truth:
    """Two views of the ball; an even light, and one that is brighter: by 3, 2, 1 on average."""
    tracer, views = Tracer(ball / "mesh_uv.ply"), []
    for view in ring(2, size=SIZE):
        *_, hit = tracer.hit(*view.rays(view.pixel_centers().reshape(-1, 2)))
        mask = hit.reshape(SIZE, SIZE)
        nothing = Picture(np.zeros((SIZE, SIZE, 3), np.float32), None)
        views.append(TrueView(view, mask, mask, nothing, {}))
    even = np.full((8, 16, 3), 0.5, np.float32)
    other = (even * [3, 2, 1]).astype(np.float32)
    pictures = [known.photo for known in views]
    return Truth(views, even, {"other": Relit(other, views, pictures)}, [])


@pytest.fixture(scope="module")
def texture() -> np.ndarray:
    out = np.full((16, 16, 3), 0.1, np.float32)
    out[:, 8:] = [0.3, 0.2, 0.05]
    return out


def test_mean_radiance_is_over_solid_angle():
    """The upper half of the sphere is half of it, in however many rows."""
    light = np.zeros((9, 18, 3))
    light[:3] = 1  # down to an elevation of 30 degrees: a quarter
    np.testing.assert_allclose(mean_radiance(light), 0.25, atol=1e-6)


def test_a_texture_knows_of_light_what_it_is_told(truth, texture, ball):
    tracer = Tracer(ball / "mesh_uv.ply")
    plain, scaled = (unlit_pictures(texture, tracer, truth, told) for told in (False, True))
    for known in truth.views:
        name = known.view.name
        own, relit = plain[f"novel/{name}"], plain[f"relight/other/{name}"]
        assert own[0][known.mask].min() > 0.01
        np.testing.assert_array_equal(own, relit)
        np.testing.assert_array_equal(own, scaled[f"novel/{name}"])
        np.testing.assert_allclose(scaled[f"relight/other/{name}"], own * [3, 2, 1], rtol=1e-5)


def test_a_matt_asset_shows_its_photos_in_an_even_light(truth, texture, ball):
    """But for what a dielectric reflects at its surface, a twenty-fifth of the light and more at
    grazing angles.
    """
    renderer, tracer = Renderer(ball / "mesh_uv.ply", 16, 8, 3), Tracer(ball / "mesh_uv.ply")
    x = matt(texture, truth.light)
    shown = rendered(renderer, x, truth, 256, lambda: None)
    textured = unlit_pictures(texture, tracer, truth, True)
    for name, pair in shown.items():
        mask = truth.views[0].mask & truth.views[1].mask
        difference = (pair.mean(0) - textured[name][0])[mask].mean(0)
        light = 0.5 * (np.array([3, 2, 1]) if name.startswith("relight") else np.ones(3))
        assert (np.abs(difference) < 0.08 * light).all()


def test_tables_name_who_is_behind():
    keys = ("relight_psnr", "relight_psnr_channel", "novel_view_psnr")
    scores = {"map": 15.0, "split_gibbs_draft": 20.0}
    scores |= {"unlit": 14.0, "unlit_scaled": 16.0, "diffuse": 21.0}
    rows = [
        {"scene": "a", "method": name, "scores": dict.fromkeys(keys, level)}
        for name, level in scores.items()
    ]
    data = {"rows": rows}
    said = losers(data)
    assert "Behind `unlit`: none." in said
    assert "Behind `unlit_scaled`: on a `map`." in said
    assert "Behind `diffuse`: on a `split_gibbs_draft`, `map`." in said
    assert "| `diffuse` | 21.0 | 21.0 | 21.0 | 2 |" in table(data)
