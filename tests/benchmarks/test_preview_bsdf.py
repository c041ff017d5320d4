"""UsdPreviewSurface as a BSDF against its formula, and its drawn directions against its values."""

import numpy as np
import pytest

from benchmarks.preview_bsdf import NAME, shown_as_preview
from pipeline.base.runtime import mitsuba as mi
from pipeline.render.principled_lobes import cosine_directions
from pipeline.render.renderer import Renderer, specular
from pipeline.usd.preview_surface import preview_albedo
from tests.render.test_renderer import explanation
from tests.seeds import numpy_rng

import drjit as dr  # isort: skip  (after Mitsuba's, which says with which LLVM)

MANY = 1 << 16


def bsdf(color, roughness, metallic, ior=1.5):
    texture = lambda *value: {
        "type": "bitmap",
        "raw": True,
        "data": mi.TensorXf(np.full((2, 2, len(value)), value, np.float32)),
    }
    return mi.load_dict(
        {
            "type": NAME,
            "specular": specular(ior),
            "base_color": texture(*[color] * 3),
            "roughness": texture(roughness),
            "metallic": texture(metallic),
        }
    )


def seen_from(directions):
    si = dr.zeros(mi.SurfaceInteraction3f, MANY)
    si.wi = directions
    si.uv = mi.Point2f(numpy_rng(3).random((2, MANY)).astype(np.float32))
    return si


def formula(color, roughness, metallic, e, light):
    """f times the cosine, of its definition: (n,)."""
    half = (e + light) / np.linalg.norm(e + light, axis=1, keepdims=True)
    alpha = roughness**2
    d = alpha**2 / (np.pi * (half[:, 2] ** 2 * (alpha**2 - 1) + 1) ** 2)
    smith = lambda z: 2 / (1 + np.sqrt(1 + alpha**2 * (1 - z**2) / z**2))
    tint = (1 - metallic) + metallic * color
    f0 = (0.04 * (1 - metallic) + metallic) * tint
    fresnel = f0 + (tint - f0) * (1 - (e * half).sum(1)) ** 5
    mirrored = fresnel * d * smith(e[:, 2]) * smith(light[:, 2]) / (4 * e[:, 2] * light[:, 2])
    return (color * (1 - metallic) * (1 - fresnel) / np.pi + mirrored) * light[:, 2]


@pytest.mark.parametrize("metallic", [0.0, 1.0, 0.4])
def test_values_are_those_of_the_definition(metallic):
    rng = numpy_rng(0)
    eye, light = cosine_directions(MANY, rng), cosine_directions(MANY, rng)
    value = bsdf(0.3, 0.5, metallic).eval(mi.BSDFContext(), seen_from(eye), light)
    expected = formula(0.3, 0.5, metallic, np.array(eye).T, np.array(light).T)
    np.testing.assert_allclose(np.array(value)[0], expected, rtol=2e-3, atol=1e-5)


@pytest.mark.parametrize("roughness, metallic", [(0.2, 0.0), (0.6, 0.0), (0.4, 1.0)])
def test_drawn_directions_give_the_albedo(roughness, metallic):
    rng = numpy_rng(0)
    eye = cosine_directions(MANY, rng)
    one = mi.Float(rng.random(MANY).astype(np.float32))
    two = mi.Point2f(rng.random((2, MANY)).astype(np.float32))
    surface = bsdf(0.5, roughness, metallic)
    drawn, weight = surface.sample(mi.BSDFContext(), seen_from(eye), one, two)
    density = surface.pdf(mi.BSDFContext(), seen_from(eye), drawn.wo)
    np.testing.assert_allclose(np.array(density), np.array(drawn.pdf), rtol=1e-3)
    if metallic == 0:
        diffuse, highlight = preview_albedo(roughness, 1.5)
        assert np.array(weight)[0].mean() == pytest.approx(0.5 * diffuse + highlight, rel=0.02)
    else:
        assert 0.4 < np.array(weight)[0].mean() < 0.5


def test_renderers_made_inside_are_viewers(ball):
    """And those made outside are not."""
    x = explanation(16, 8)
    rays = np.array([[0, 0, 3.0]] * 2000, np.float32), np.array([[0, 0, -1.0]] * 2000, np.float32)

    def brightness():
        made = Renderer(ball / "mesh_uv.ply", 16, 8, 2)
        made.set(x)
        return made.radiance(*rays, seed=1).mean()

    ours = brightness()
    with shown_as_preview():
        theirs = brightness()
    assert abs(theirs / ours - 1) > 0.01
    assert brightness() == ours
