"""The `principled` BSDF as a sum of four lobes whose weights are the material.

    f = (1 - m) (a A + S) + m (a M1 + (1 - a) M0)

for base colour a and metallic m, where A is the diffuse lobe, S the dielectric highlight, M1 and M0
the metal one at a = 1 and at a = 0. All four depend on the roughness alone. (Exact to rounding for
Mitsuba's `principled`; a test holds it to that.)
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import drjit as dr
import numpy as np

from pipeline.base.runtime import mitsuba as mi
from pipeline.render.renderer import GLASS, specular

LOBES = ("diffuse", "dielectric", "metal white", "metal black")  # A, S, M1, M0
ALBEDO_SAMPLES = 1 << 16  # of a lobe's albedo: good to .3 %


def principled_bsdf(metallic: float, color: float, roughness: float, ior: float = GLASS) -> Any:
    """Mitsuba's BSDF of one grey material; the renderer's with constant maps."""
    return mi.load_dict(
        {
            "type": "principled",
            "specular": specular(ior),
            "base_color": {"type": "rgb", "value": color},
            "metallic": metallic,
            "roughness": roughness,
        }
    )


class PrincipledLobes:
    """The four lobes at one roughness and index of refraction, times the cosine, for directions in
    the local frame.

    Every method takes a Mitsuba surface interaction `si` of which only the local incident direction
    is read, and local outgoing directions `wo`; a lane is one pair of them.
    """

    def __init__(self, roughness: float, ior: float = GLASS):
        self.white = principled_bsdf(0.0, 1.0, roughness, ior)
        self.black = principled_bsdf(0.0, 0.0, roughness, ior)
        self.white_metal = principled_bsdf(1.0, 1.0, roughness)
        self.black_metal = principled_bsdf(1.0, 0.0, roughness)
        self.context = mi.BSDFContext()

    def __call__(self, si: Any, wo: Any) -> np.ndarray:
        """Values (4, lanes) in the order of LOBES."""
        value = lambda bsdf: np.array(bsdf.eval(self.context, si, wo)[0])
        white = value(self.white)
        dielectric = value(self.black)  # a black dielectric has nothing but its highlight
        return np.stack(
            [white - dielectric, dielectric, value(self.white_metal), value(self.black_metal)]
        )

    def highlight_density(self, si: Any, wo: Any) -> np.ndarray:
        """Density (lanes,) per solid angle with which `sample_highlight` draws `wo`."""
        return np.array(self.white_metal.pdf(self.context, si, wo))

    def sample_highlight(self, si: Any, square: np.ndarray) -> Any:
        """Local directions drawn from the highlight, one per lane, by points `square` (2, lanes) of
        the unit square.
        """
        # the highlight is all that a metal has: nothing is left to choose by a first number
        one = dr.full(mi.Float, 0.5, square.shape[1])
        two = mi.Point2f(np.ascontiguousarray(square, np.float32))
        return self.white_metal.sample(self.context, si, one, two)[0].wo


def blurred_roughness(roughness: np.ndarray, sigma: np.ndarray) -> np.ndarray:
    """Roughness of the lobe that a surface of this roughness shows whose normals spread about
    the mean by `sigma` per axis (radians): (alpha^2 + 2 sigma^2)^(1/4), with alpha =
    roughness^2, at most 1. Arrays that broadcast.

    Facets' slopes have variance alpha^2 / 2 per axis (exact for Beckmann's distribution, close for
    GGX near its peak), and variances of slopes add (Toksvig 2005; Han et al. 2007; Olano and Baker
    2010, "LEAN mapping").
    """
    return np.minimum((roughness**4 + 2 * sigma**2) ** 0.25, 1.0)


@lru_cache
def lobe_albedo(roughness: float, ior: float = GLASS) -> np.ndarray:
    """Share of uniform light that each lobe reflects (4,): f cos over both hemispheres' cosines, by
    the balance heuristic between directions of the diffuse lobe and of the highlight. A rough metal
    has no more than .4, for what its facets reflect twice is not in the BSDF.
    """
    lobes = PrincipledLobes(roughness, ior)
    rng = np.random.default_rng(0)
    si = dr.zeros(mi.SurfaceInteraction3f, ALBEDO_SAMPLES)
    si.wi = cosine_directions(ALBEDO_SAMPLES, rng)

    total = np.zeros(4)
    for wo in (
        cosine_directions(ALBEDO_SAMPLES, rng),
        lobes.sample_highlight(si, rng.random((2, ALBEDO_SAMPLES))),
    ):
        density = np.array(dr.maximum(wo.z, 0)) / np.pi + lobes.highlight_density(si, wo)
        total += (np.nan_to_num(lobes(si, wo)) / np.maximum(density, 1e-6)).mean(1)
    return total


def cosine_directions(count: int, rng: np.random.Generator) -> Any:
    """`count` directions in the local frame with density cosine / pi."""
    square = mi.Point2f(rng.random((2, count), np.float32))
    return mi.warp.square_to_cosine_hemisphere(square)
