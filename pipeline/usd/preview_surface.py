"""A material as UsdPreviewSurface needs it to show what the renderer shows.

The exported material has the roughness and metallic of the renderer's, and its highlight, but not
its diffuse lobe. UsdPreviewSurface (its specification, version 2.6, and the shader that comes with
OpenUSD) takes what a dielectric mirrors off what it scatters, and has Lambert's lobe and not
Disney's, which brightens with roughness: the same numbers are shown darker, by 2 % at roughness .2
and 10 % at 1. So the base colour a' that is exported of a dielectric is the one that reflects as
much of an even light as the renderer's a does:

    A a + S = D a' + G

A and S are the albedos of the renderer's diffuse lobe and highlight (render/principled_lobes.py), D
and G those of UsdPreviewSurface. A metal keeps its base colour: seen from the front both reflect
the same, and what Mitsuba's has more at grazing angles must not lift the rest. How either falls off
with the angle stays the viewer's own.

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


def for_preview_surface(x: Explanation) -> tuple[Explanation, float]:
    """The explanation with the numbers of a UsdPreviewSurface that shows it, and the share of its
    base colours' values that ended at 1 because none as bright would do.
    """
    factor, more = _difference(x, x.roughness)
    color = factor * x.base_color + more
    clipped = float((color > 1).mean())
    color = np.clip(color, 0, 1).astype(np.float32)
    return replace(x, base_color=color, roughness=_where_bare(x, 1.0)), clipped


def from_preview_surface(x: Explanation) -> Explanation:
    """The renderer's numbers for those of a UsdPreviewSurface: `for_preview_surface` undone."""
    roughness = _where_bare(x, LAMBERTIAN)
    factor, more = _difference(x, roughness)
    color = np.clip((x.base_color - more) / factor, 0, 1).astype(np.float32)
    return replace(x, base_color=color, roughness=roughness)


def _where_bare(x: Explanation, roughness: float) -> np.ndarray:
    """Roughness (t, t), this one where the surface has no highlight and is no metal."""
    if x.ior != NO_HIGHLIGHT:
        return x.roughness
    return (x.metallic * x.roughness + (1 - x.metallic) * roughness).astype(np.float32)


def _difference(x: Explanation, roughness: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """By what a base colour (t, t, 3) is multiplied and what is added to it, (t, t, 1) each, to
    have that of UsdPreviewSurface. roughness (s, s): the renderer's.
    """
    ours = np.stack([lobe_albedo(float(r), x.ior)[:2] for r in ROUGHNESS])
    shown = np.ones_like(ROUGHNESS) if x.ior == NO_HIGHLIGHT else ROUGHNESS
    preview = np.stack([preview_albedo(float(r), x.ior) for r in shown])
    of_roughness = np.stack([ours[:, 0], ours[:, 1] - preview[:, 1]], 1) / preview[:, :1]

    size = x.base_color.shape[1::-1]
    at_color = lambda image: cv2.resize(image, size, interpolation=cv2.INTER_LINEAR)[..., None]
    metallic, rough = at_color(x.metallic), at_color(roughness)
    factor, more = (np.interp(rough, ROUGHNESS, column) for column in of_roughness.T)
    return metallic + (1 - metallic) * factor, (1 - metallic) * more
