"""UsdPreviewSurface as a BSDF of Mitsuba, to render an asset as a viewer shows it.

Metallic workflow of its specification, version 2.6, as OpenUSD's own shader evaluates a light
(previewSurface.glslfx): for base colour a, metallic m, and R the reflectance head-on of its index
of refraction,

    c = (1 - m) + m a,    F0 = ((1 - m) R + m) c,    F = F0 + (c - F0) (1 - e.h)^5
    f = a (1 - m) (1 - F) / pi + F D G / (4 n.l n.e)

for the directions l of the light, e of the eye, h halfway and n of the normal; D is GGX of alpha =
roughness^2. The shader's Schlick-Smith G and the small numbers that keep its quotients finite are
left out: G is Smith's. It is drawn from the light's cosine or the visible facets.

`shown_as_preview` makes the renderer's scenes of it. Without a gradient, and slower than Mitsuba's
own: a yardstick, not a model to fit.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any
from unittest import mock

# Mitsuba before Dr.Jit: pipeline/base/runtime.py says with which LLVM
from pipeline.base.runtime import mitsuba as mi

import drjit as dr  # isort: skip

from pipeline.render import renderer

NAME = "usd_preview_surface"
SMOOTHEST = 0.03  # roughness, below which it would be a mirror
MIRRORED = 0.35  # share of a dielectric's directions that are drawn from its facets
TINY = 1e-8


class PreviewSurface(mi.BSDF):
    """Takes `principled`'s textures `base_color`, `roughness` and `metallic`, and its `specular`,
    the reflectance head-on as a share of .08.
    """

    def __init__(self, props: Any):
        mi.BSDF.__init__(self, props)
        self.maps = {name: props[name] for name in renderer.MAPS}
        self.specular = mi.Float(props["specular"])
        front = mi.BSDFFlags.FrontSide
        self.m_components = [
            mi.BSDFFlags.DiffuseReflection | front,
            mi.BSDFFlags.GlossyReflection | front,
        ]
        self.m_flags = self.m_components[0] | self.m_components[1]

    def traverse(self, callback: Any) -> None:
        for name, texture in self.maps.items():
            callback.put(name, texture, mi.ParamFlags.NonDifferentiable)
        callback.put("specular", self.specular, mi.ParamFlags.NonDifferentiable)

    def eval(self, context: Any, si: Any, wo: Any, active: Any = True) -> Any:
        return self._value(si, wo, active)

    def pdf(self, context: Any, si: Any, wo: Any, active: Any = True) -> Any:
        return self._density(si, wo, active)

    def eval_pdf(self, context: Any, si: Any, wo: Any, active: Any = True) -> tuple[Any, Any]:
        return self._value(si, wo, active), self._density(si, wo, active)

    def sample(
        self, context: Any, si: Any, one: Any, two: Any, active: Any = True
    ) -> tuple[Any, Any]:
        of_facet = mi.reflect(si.wi, self._facets(si, active).sample(si.wi, two)[0])
        of_cosine = mi.warp.square_to_cosine_hemisphere(two)
        out = dr.zeros(mi.BSDFSample3f)
        out.wo = dr.select(one < self._mirrored(si, active), of_facet, of_cosine)
        out.eta = 1.0
        out.sampled_type = mi.UInt32(+mi.BSDFFlags.GlossyReflection)
        out.pdf = self._density(si, out.wo, active)
        value = self._value(si, out.wo, active)
        return out, dr.select(out.pdf > TINY, value / dr.maximum(out.pdf, TINY), 0)

    def to_string(self) -> str:
        return NAME

    def _facets(self, si: Any, active: Any) -> Any:
        roughness = dr.maximum(self.maps["roughness"].eval_1(si, active), SMOOTHEST)
        return mi.MicrofacetDistribution(mi.MicrofacetType.GGX, roughness**2, True)

    def _mirrored(self, si: Any, active: Any) -> Any:
        """Share of directions that are drawn from the facets."""
        return dr.lerp(MIRRORED, 1.0, self.maps["metallic"].eval_1(si, active))

    def _value(self, si: Any, wo: Any, active: Any) -> Any:
        """f times the cosine."""
        color = self.maps["base_color"].eval(si, active)
        metallic = self.maps["metallic"].eval_1(si, active)
        facets = self._facets(si, active)
        half = dr.normalize(si.wi + wo)
        tint = dr.lerp(mi.Color3f(1), color, metallic)
        head_on = dr.lerp(0.08 * self.specular, mi.Float(1), metallic) * tint
        fresnel = dr.lerp(head_on, tint, (1 - dr.dot(si.wi, half)) ** 5)
        mirrored = fresnel * facets.eval(half) * facets.G(si.wi, wo, half)
        mirrored /= 4 * dr.maximum(wo.z * si.wi.z, TINY)
        scattered = color * (1 - metallic) * (1 - fresnel) / dr.pi
        lit = active & (wo.z > 0) & (si.wi.z > 0)
        return dr.select(lit, (scattered + mirrored) * wo.z, 0)

    def _density(self, si: Any, wo: Any, active: Any) -> Any:
        """With which `sample` draws wo, per solid angle."""
        half = dr.normalize(si.wi + wo)
        of_facet = self._facets(si, active).pdf(si.wi, half) / (
            4 * dr.maximum(dr.dot(wo, half), TINY)
        )
        lit = active & (wo.z > 0) & (si.wi.z > 0)
        return dr.select(lit, dr.lerp(wo.z / dr.pi, of_facet, self._mirrored(si, active)), 0)


mi.register_bsdf(NAME, PreviewSurface)


@contextmanager
def shown_as_preview() -> Iterator[None]:
    """Renderers that are made inside have this BSDF in place of `principled`."""
    with mock.patch.object(renderer, "BSDF", NAME):
        yield
