"""A material as UsdPreviewSurface needs it to show what the renderer shows.

The exported material has the roughness of the renderer's, and its highlight, but not its diffuse
lobe. UsdPreviewSurface (its specification, version 2.6, and the shader that comes with OpenUSD)
takes what a dielectric mirrors off what it scatters, and has Lambert's lobe and not Disney's, which
brightens with roughness: the same numbers are shown darker, by 2 % at roughness .2 and 10 % at 1.

Blender's importer makes a Principled BSDF of it, whose highlight lies over Lambert's lobe and lets
through what it does not reflect itself, 1 - S (measured in an even light, Blender 5.0.1, to .003):
rough things are brighter by up to 4 % than in UsdPreviewSurface, glossy ones darker by up to 3 %.
An asset lies halfway.

And viewers disagree about a metallic between 0 and 1. The renderer, and MaterialX's graph of
UsdPreviewSurface, mix what a metal and a dielectric reflect; OpenUSD's shader also mixes the
metal's tint with white, and mirrors several times as much where base colours are dark. In the mean
of samples that disagree about a metal that was 2 and 4 dB of held-out photos. So there every texel
is made a metal or none. A sample of `split_gibbs` is so anyway; others' are exported as they are.

A base colour a' is exported that reflects as much of an even light as the renderer's a does:

    (1 - m) (A a + S) + m (M1 a + M0 (1 - a))  =  (1 - m') (D a' + G) + m' (M1 a' + M0 (1 - a'))

for metallic m and, as exported, m'; A, S, M1 and M0 are the albedos of the renderer's lobes
(principled_lobes.py), D and G those of viewers, the mean of UsdPreviewSurface's and of Blender's,
1 - S and S. A metal keeps its base colour by that:
seen from the front both models reflect the same, and what Mitsuba's has more at grazing angles must
not lift the rest. How either falls off with the angle stays the viewer's own.

Without a highlight (index of refraction 1) UsdPreviewSurface still mirrors at grazing angles, by
Schlick's formula, whatever its workflow; least at roughness 1, which such an asset gets.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import cv2
import drjit as dr
import numpy as np

from pipeline.base.runtime import mitsuba as mi
from pipeline.render.principled_lobes import ALBEDO_SAMPLES, cosine_directions, lobe_albedo
from pipeline.render.renderer import LAMBERTIAN, NO_HIGHLIGHT, Explanation, head_on

ROUGHNESS = np.linspace(0.04, 1, 13)  # at which albedos are worked out; others are interpolated


@lru_cache
def preview_albedo(roughness: float, ior: float) -> np.ndarray:
    """Share of an even light that UsdPreviewSurface's lobes reflect (2,): D, the diffuse lobe of a
    white dielectric, and G, its highlight, which without one, ior 1, is what it mirrors at grazing
    angles.

    GGX with Smith's masking (Walter et al. 2007), by visible normals (Heitz 2018), and Schlick's
    Fresnel term, by Monte Carlo: good to .3 %.
    """
    rng = np.random.default_rng(0)
    eye, light = cosine_directions(ALBEDO_SAMPLES, rng), cosine_directions(ALBEDO_SAMPLES, rng)
    reflectance = head_on(ior)
    schlick = lambda cosine: reflectance + (1 - reflectance) * (1 - cosine) ** 5
    diffuse = 1 - schlick(dr.dot(eye, dr.normalize(eye + light)))

    facets = mi.MicrofacetDistribution(mi.MicrofacetType.GGX, roughness**2, True)
    square = mi.Point2f(rng.random((2, ALBEDO_SAMPLES)).astype(np.float32))
    facet = facets.sample(eye, square)[0]
    mirrored = mi.reflect(eye, facet)
    lit = dr.select(mirrored.z > 0, facets.smith_g1(mirrored, facet), 0)
    highlight = lit * schlick(dr.dot(eye, facet))
    return np.array([np.array(lobe).mean() for lobe in (diffuse, highlight)])


def viewers_albedo(roughness: float, ior: float) -> np.ndarray:
    """D and G (2,), the mean of what UsdPreviewSurface and Blender show."""
    highlight = lobe_albedo(roughness, ior)[1]
    return (preview_albedo(roughness, ior) + [1 - highlight, highlight]) / 2


def for_preview_surface(x: Explanation, decide: bool = False) -> tuple[Explanation, float]:
    """The explanation with the numbers of a UsdPreviewSurface with which viewers show it, and the
    share of its base colours' values that ended at 1 because none as bright would do. decide: make
    every texel a metal or none.
    """
    diffuse, highlight, metal, edge, shown_diffuse, shown_highlight = _albedos(x, x.roughness)
    metallic = _at_color(x, x.metallic)
    of_dielectric = diffuse * x.base_color + highlight
    reflected = (1 - metallic) * of_dielectric + metallic * (metal * x.base_color + edge)

    shown_metallic = (x.metallic >= 0.5).astype(np.float32) if decide else x.metallic
    decided = _at_color(x, shown_metallic)  # between 0 and 1 at a metal's rim, in a viewer too
    of_black = (1 - decided) * shown_highlight + decided * edge
    color = (reflected - of_black) / ((1 - decided) * shown_diffuse + decided * metal)
    shown = replace(
        x,
        base_color=np.clip(color, 0, 1).astype(np.float32),
        roughness=_where_bare(x, 1.0),
        metallic=shown_metallic,
    )
    return shown, float((color > 1).mean())


def from_preview_surface(x: Explanation) -> Explanation:
    """The renderer's numbers for those of a UsdPreviewSurface: `for_preview_surface` undone, as far
    as that decided nothing. A metallic between 0 and 1 mixes what either reflects.
    """
    roughness = _where_bare(x, LAMBERTIAN)
    diffuse, highlight, metal, _, shown_diffuse, shown_highlight = _albedos(x, roughness)
    metallic = _at_color(x, x.metallic)
    of_dielectric = shown_diffuse * x.base_color + shown_highlight - highlight
    reflected = (1 - metallic) * of_dielectric + metallic * metal * x.base_color
    color = reflected / ((1 - metallic) * diffuse + metallic * metal)
    return replace(x, base_color=np.clip(color, 0, 1).astype(np.float32), roughness=roughness)


def _where_bare(x: Explanation, roughness: float) -> np.ndarray:
    """Roughness (t, t), this one where the surface has no highlight and is no metal."""
    if x.ior != NO_HIGHLIGHT:
        return x.roughness
    return (x.metallic * x.roughness + (1 - x.metallic) * roughness).astype(np.float32)


def _at_color(x: Explanation, image: np.ndarray) -> np.ndarray:
    """A map (s, s) at the base colour's texels (t, t, 1)."""
    size = x.base_color.shape[1::-1]
    return cv2.resize(image, size, interpolation=cv2.INTER_LINEAR)[..., None]


def _albedos(x: Explanation, roughness: np.ndarray) -> list[np.ndarray]:
    """At the base colour's texels (t, t, 1): A and S; of a metal what its base colour is multiplied
    by and what it reflects at a base colour of 0, M1 - M0 and M0; D and G of viewers. roughness
    (s, s): the renderer's.
    """
    ours = np.stack([lobe_albedo(float(r), x.ior) for r in ROUGHNESS])
    shown = np.ones_like(ROUGHNESS) if x.ior == NO_HIGHLIGHT else ROUGHNESS
    preview = np.stack([viewers_albedo(float(r), x.ior) for r in shown])
    diffuse, highlight, white, edge = ours.T
    at = _at_color(x, roughness)
    columns = (diffuse, highlight, white - edge, edge, *preview.T)
    return [np.interp(at, ROUGHNESS, column) for column in columns]
