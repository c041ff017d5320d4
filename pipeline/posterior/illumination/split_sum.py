"""Shading as a rasteriser does it: an analogue of nvdiffrec's (Munkberg et al. 2022) on our mesh.

Split sum (Karis 2013): nothing shadows or lights anything else, and the highlight is a product of a
prefiltered light and an albedo of the facets,

    L = a (1 - m) E(n) / pi + (F0 A + B) P(r, reflected),   F0 = 0.04 (1 - m) + a m

with base colour a, metallic m, roughness r, irradiance E, the light P prefiltered for a facet seen
head-on, and the albedo's two parts A and B by roughness and cosine. It replaces the path tracer in
`Problem.gradient`; a product of matrices with the light is differentiable as it stands.

Letters: n rays, M pixels of the light, K levels of roughness.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import torch

from pipeline.base.runtime import mitsuba_rays
from pipeline.posterior.problem import PixelBatch, Problem
from pipeline.posterior.textures import bilinear_matrix
from pipeline.render.envmap import directions, solid_angles
from pipeline.render.light_grid import bilinear
from pipeline.render.renderer import Explanation, Gradient, LossAndSlope, Renderer
from pipeline.render.shading_normals import shading_normals

ROUGHNESS = np.linspace(0.05, 1.0, 8)  # levels that the light is prefiltered for
COSINES = np.linspace(0.0, 1.0, 33)  # of the albedo's table
FACETS = 1024  # microfacets that an entry of the table is averaged over
DIELECTRIC = 0.04  # reflectance head-on, that of Mitsuba's `specular` 0.5


def ggx(cosine: np.ndarray, alpha: float) -> np.ndarray:
    """Density of facets whose normals have this cosine (Walter et al. 2007, their equation 33)."""
    return alpha**2 / (np.pi * (cosine**2 * (alpha**2 - 1) + 1) ** 2)


def shadowing(cosine: np.ndarray, alpha: float) -> np.ndarray:
    """Smith's share of facets seen under a cosine (Walter et al. 2007, their equation 34)."""
    cosine = np.maximum(cosine, 1e-4)
    return 2 / (1 + np.sqrt(1 + alpha**2 * (1 / cosine**2 - 1)))


@lru_cache
def facet_albedo() -> torch.Tensor:
    """A and B (2, K, COSINES): share of uniform light that the highlight reflects, F0 A + B with
    Schlick's Fresnel term, by GGX facets drawn evenly (Karis 2013, `IntegrateBRDF`).
    """
    u = (np.arange(FACETS) + 0.5) / FACETS
    turn = 2 * np.pi * ((np.arange(FACETS) * 0.618034) % 1)
    table = np.zeros((2, len(ROUGHNESS), len(COSINES)))
    for k, roughness in enumerate(ROUGHNESS):
        alpha = roughness**2
        height = np.sqrt((1 - u) / (1 + (alpha**2 - 1) * u))
        facet = np.stack([np.sqrt(1 - height**2) * np.cos(turn), height], -1)  # x and z
        for i, cosine in enumerate(np.maximum(COSINES, 1e-3)):
            meets = facet @ [np.sqrt(1 - cosine**2), cosine]  # cosine at the facet
            out = 2 * meets * height - cosine  # z of the reflected direction
            seen = (meets > 0) & (out > 0)
            both = shadowing(out, alpha) * shadowing(np.array(cosine), alpha)
            weight = np.where(seen, both * meets / (height * cosine), 0)
            fresnel = (1 - meets.clip(0, 1)) ** 5
            table[:, k, i] = (weight * (1 - fresnel)).mean(), (weight * fresnel).mean()
    return torch.from_numpy(table.astype(np.float32))


@lru_cache
def prefilters(h: int) -> torch.Tensor:
    """(K + 1, M, M): a light (M, c) with h rows as a facet of each roughness shows it head-on in
    the direction of every pixel (rows sum to 1), and its irradiance for normals there (rows sum to
    pi).
    """
    unit = directions(h, 2 * h).reshape(-1, 3)
    area = solid_angles(h, 2 * h).reshape(-1)
    cosine = (unit @ unit.T).clip(-1, 1)
    falling = np.maximum(cosine, 0)
    half = np.sqrt((1 + cosine) / 2)  # between the normal and halfway to the light
    levels = [ggx(half, roughness**2) * falling * area for roughness in ROUGHNESS]
    levels = [level / level.sum(1, keepdims=True) for level in levels]
    irradiance = falling * area
    irradiance *= np.pi / irradiance.sum(1, keepdims=True)
    return torch.from_numpy(np.stack([*levels, irradiance]).astype(np.float32))


def filtered(light: torch.Tensor) -> torch.Tensor:
    """A light (h, 2h, 3) by each of `prefilters`, (K + 1, M, 3).

    As `linear` the three channels are read together, forwards and back: a fifth of the time of
    `prefilters @ light`, whose gradient reads the filters column by column.
    """
    filters = prefilters(len(light))
    channels = light.reshape(-1, 3).T.contiguous()
    shown = torch.nn.functional.linear(channels, filters.reshape(-1, filters.shape[2]))
    return shown.T.reshape(*filters.shape[:2], 3)


def looked_up(values: torch.Tensor, direction: np.ndarray, h: int) -> torch.Tensor:
    """Bilinear (..., n, c) in directions (n, 3) of pixels (..., M, c)."""
    index, weight = bilinear(direction, h)
    corners = values[..., torch.from_numpy(index), :]  # (..., n, 4, c)
    return (corners * torch.from_numpy(weight.astype(np.float32))[..., None]).sum(-2)


def between(position: torch.Tensor, count: int) -> tuple[torch.Tensor, torch.Tensor]:
    """The step below a position on a scale of `count` steps, and the share of the one above."""
    below = position.detach().floor().clamp(0, count - 2)
    return below.long(), position - below


@dataclass(frozen=True)
class Met:
    """What rays (n, 3) meet: whether they do (n,); the normal on their side and the reflected
    direction (n, 3); cosine of incidence (n,); the texels' bilinear weights, sparse (n, t^2).
    """

    hit: torch.Tensor
    normal: np.ndarray
    reflected: np.ndarray
    cosine: torch.Tensor
    texels: torch.Tensor

    @classmethod
    def by(cls, renderer: Renderer, side: int, origins: np.ndarray, outward: np.ndarray) -> Met:
        """side: texels along a side of the maps."""
        surface = renderer.scene.ray_intersect(mitsuba_rays(origins, outward))
        hit = np.array(surface.is_valid()).astype(np.float32)
        normal = shading_normals(surface, renderer.surface)
        normal = np.where(hit[:, None] > 0, normal, -outward)  # any: such rays are black
        facing = -(normal * outward).sum(1, keepdims=True)
        normal = np.where(facing < 0, -normal, normal)  # both sides of a face are alike
        cosine = np.abs(facing)

        uv = np.array(surface.uv).T * [1, -1] + [0, 1]  # v up
        weights = bilinear_matrix(uv, side).tocoo()
        texels = torch.sparse_coo_tensor(
            torch.from_numpy(np.stack([weights.row, weights.col])),
            torch.from_numpy(weights.data),
            weights.shape,
            check_invariants=False,
        )
        return cls(
            torch.from_numpy(hit),
            normal,
            outward + 2 * cosine * normal,
            torch.from_numpy(cosine[:, 0].astype(np.float32)),
            texels,
        )

    def values(self, image: torch.Tensor) -> torch.Tensor:
        """Bilinear values (n, c) of a map (t, t) or (t, t, c)."""
        return self.texels @ image.reshape(self.texels.shape[1], -1)


def highlight(
    met: Met, roughness: torch.Tensor, head_on: torch.Tensor, levels: torch.Tensor, h: int
) -> torch.Tensor:
    """(F0 A + B) P of every ray (n, 3); roughness (n,), head_on: F0 (n, 3), levels (K, M, 3)."""
    scale = (len(ROUGHNESS) - 1) / (ROUGHNESS[-1] - ROUGHNESS[0])
    step, share = between((roughness - ROUGHNESS[0]) * scale, len(ROUGHNESS))
    column, beyond = between(met.cosine * (len(COSINES) - 1), len(COSINES))
    shown = looked_up(levels, met.reflected, h)
    table, ray = facet_albedo(), torch.arange(len(step))

    def at(k: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Albedo's parts (2, n) and the light (n, 3) of level k of each ray."""
        albedo = (1 - beyond) * table[:, k, column] + beyond * table[:, k, column + 1]
        return albedo, shown[k, ray]

    (albedo, light), (more_albedo, more_light) = at(step), at(step + 1)
    A, B = (albedo + share * (more_albedo - albedo))[..., None]
    return (head_on * A + B) * (light + share[:, None] * (more_light - light))


class SplitSum(Problem):
    """A problem whose gradient is that of split-sum shading. Pixels beside the object are black."""

    def shaded(
        self, maps: dict[str, torch.Tensor], origins: np.ndarray, outward: np.ndarray
    ) -> torch.Tensor:
        """Radiance (n, 3) along rays (n, 3); maps: "light" (h, 2h, 3), "base_color" (t, t, 3),
        "roughness" and "metallic" (t, t).
        """
        met = Met.by(self.renderer, len(maps["roughness"]), origins, outward)
        color, metallic = met.values(maps["base_color"]), met.values(maps["metallic"])
        h = len(maps["light"])
        shown = filtered(maps["light"])

        irradiance = looked_up(shown[-1], met.normal, h)
        diffuse = color * (1 - metallic) * irradiance / np.pi
        head_on = DIELECTRIC * (1 - metallic) + color * metallic
        roughness = met.values(maps["roughness"])[:, 0]
        gloss = highlight(met, roughness, head_on, shown[:-1], h)
        return met.hit[:, None] * (diffuse + gloss)

    def gradient(
        self,
        explanation: Explanation,
        batch: PixelBatch,
        seed: int,
        loss_and_slope: LossAndSlope | None = None,
    ) -> Gradient:
        """As `Problem.gradient`; there are no random paths, so `seed` changes nothing."""
        names = ("light", "base_color", "roughness", "metallic")
        maps = {
            name: torch.from_numpy(getattr(explanation, name).copy()).requires_grad_(True)
            for name in names
        }
        rays = (rays.reshape(-1, 3) for rays in (batch.origins, batch.directions))
        paths = self.shaded(maps, *rays).reshape(*batch.origins.shape[:2], 3)
        radiance = paths.mean(0)
        loss, slope = (loss_and_slope or self.relative_loss(batch))(radiance.detach().numpy())
        parts = torch.autograd.grad(
            radiance, list(maps.values()), torch.from_numpy(slope.astype(np.float32))
        )
        found = {name: part.numpy() for name, part in zip(maps, parts)}
        return Gradient(**found, loss=loss)
