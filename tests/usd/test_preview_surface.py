"""Numbers for UsdPreviewSurface and back, and what its shading model reflects by them."""

from dataclasses import replace

import numpy as np
import pytest

from pipeline.render.principled_lobes import lobe_albedo
from pipeline.render.renderer import LAMBERTIAN, Explanation
from pipeline.usd.preview_surface import (
    for_preview_surface,
    from_preview_surface,
    preview_albedo,
    viewers_albedo,
)
from tests.seeds import numpy_rng


def material(color=0.4, roughness=0.5, metallic=0.0, ior=1.5) -> Explanation:
    """One colour and gloss all over."""
    flat = lambda value: np.full((4, 4), value, np.float32)
    light = np.ones((4, 8, 3), np.float32)
    color = np.full((8, 8, 3), color, np.float32)
    return Explanation(light, color, flat(roughness), flat(metallic), ior=ior)


@pytest.mark.parametrize("roughness", [0.1, 0.45, 1.0])
def test_a_dielectric_reflects_as_much_of_an_even_light(roughness):
    """In the mean of two viewers, of which one is as much too bright as the other is too dark."""
    shown, _ = for_preview_surface(material(0.4, roughness))
    diffuse, highlight = lobe_albedo(roughness)[:2]
    preview_diffuse, preview_highlight = preview_albedo(roughness, 1.5)
    color = shown.base_color[0, 0, 0]
    one = color * preview_diffuse + preview_highlight
    other = color * (1 - highlight) + highlight
    expected = 0.4 * diffuse + highlight
    assert (one + other) / 2 == pytest.approx(expected, rel=0.005)
    assert abs(one - expected) < 0.03 * expected


# by roughness: what a base colour of 0 and one of .5 reflect in Blender 5.0.1
# (benchmarks/blender_furnace.py)
IN_BLENDER = {
    0.1: (0.0910, 0.5454),
    0.3: (0.0797, 0.5397),
    0.6: (0.0503, 0.5241),
    1: (0.0219, 0.5108),
}


def test_the_other_viewer_is_blender():
    """Lambert's lobe, less what the highlight reflects."""
    for roughness, (black, grey) in IN_BLENDER.items():
        highlight = lobe_albedo(float(roughness))[1]
        diffuse = 2 * viewers_albedo(roughness, 1.5)[0] - preview_albedo(roughness, 1.5)[0]
        assert abs(highlight - black) < 0.004
        assert abs(0.5 * diffuse + highlight - grey) < 0.003


def test_a_metal_keeps_its_colour():
    shown, _ = for_preview_surface(material(metallic=1.0))
    np.testing.assert_allclose(shown.base_color, material().base_color, rtol=1e-5)


@pytest.mark.parametrize("metallic, decided", [(0.45, 0.0), (0.55, 1.0)])
def test_what_is_half_a_metal_is_one_or_none_and_reflects_as_much(metallic, decided):
    """Where that is asked for, for viewers disagree about what lies between."""
    kept, _ = for_preview_surface(material(0.4, 0.5, metallic))
    assert (kept.metallic == np.float32(metallic)).all()
    shown, _ = for_preview_surface(material(0.4, 0.5, metallic), decide=True)
    assert (shown.metallic == decided).all()
    diffuse, highlight, metal, edge = lobe_albedo(0.5)
    reflected = (1 - metallic) * (0.4 * diffuse + highlight) + metallic * (0.4 * metal + 0.6 * edge)
    color = shown.base_color[0, 0, 0]
    if decided:
        assert color * metal + (1 - color) * edge == pytest.approx(reflected, rel=1e-3)
    else:
        shown_diffuse, shown_highlight = viewers_albedo(0.5, 1.5)
        assert color * shown_diffuse + shown_highlight == pytest.approx(reflected, rel=1e-3)


def test_without_a_highlight_roughness_is_1_and_the_colour_nearly_the_same():
    """What mirrors at grazing angles all the same is least there."""
    bare = material(roughness=LAMBERTIAN, ior=1.0)
    shown, _ = for_preview_surface(bare)
    assert (shown.roughness == 1).all() and shown.ior == 1
    np.testing.assert_allclose(shown.base_color, bare.base_color, rtol=0.02)
    assert preview_albedo(1.0, 1.0)[1] < 0.2 * preview_albedo(LAMBERTIAN, 1.0)[1]


@pytest.mark.parametrize("ior", [1.5, 1.3, 1.0])
def test_what_is_read_back_is_what_was_written(ior):
    """With maps of gloss smaller than the colour's."""
    rng = numpy_rng(0)
    gloss = rng.random((2, 16, 16)).astype(np.float32)
    x = material(ior=ior)
    color = rng.uniform(0.02, 0.8, (64, 64, 3)).astype(np.float32)
    roughness = np.full_like(gloss[0], LAMBERTIAN) if ior == 1 else gloss[0]
    metallic = np.round(gloss[1]) if ior == 1 else gloss[1]
    x = replace(x, base_color=color, roughness=roughness, metallic=metallic)
    shown, clipped = for_preview_surface(x)
    back = from_preview_surface(shown)
    assert clipped == 0
    np.testing.assert_allclose(back.base_color, x.base_color, atol=1e-5)
    dielectric = x.metallic == 0
    np.testing.assert_array_equal(back.roughness[dielectric], x.roughness[dielectric])


def test_colours_that_no_surface_is_bright_enough_for_are_counted():
    color = np.full((8, 8, 3), 0.3, np.float32)
    color[:2] = 0.98
    shown, clipped = for_preview_surface(replace(material(), base_color=color))
    assert clipped == 0.25 and shown.base_color.max() == 1
