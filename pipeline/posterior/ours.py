"""`split_gibbs`: one posterior draw of light and materials from the transport operator and the diffusion prior.

Set-up: rows of the photos over the surface (transport.py), regions of like colour, the noise and its design effect from
the residuals of the fit. Then the turns of split_gibbs.py, each followed by moves of materials, scale and noise.
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import torch

from ..config import Sample
from ..optics import Explanation
from ..prior import load_prior
from ..prior.code import scale_of
from ..prior.sampling import reverse_diffusion
from ..progress import Bar
from ..transport import Transport, choose_rows
from .likelihood import Lobes, Photos, Theta, channel_effect, design_effect
from .problem import Problem, generators
from .refine import fill, gather, splat
from .region_moves import BRIGHTNESS_PRIOR, METALLIC, draw_gauge, draw_regions, log_prior
from .evidence import COMPONENTS, Search
from .regions import group, texel_regions
from .split_gibbs import SLICES, draw_light, prior_steps, widths

FIRST, LAST = 1.0, 0.01     # widths of the splitting in code units, where the prior's deviation is 0.5
COLOUR_SPREAD = 0.8         # deviation of log base colour in the reference Gaussian of the colours
WARM_UP = 150               # region steps at the fit's light, for the noise and as the start
NODES = 0.5                 # radiosity nodes beside the points, as a share of their number


class CodedPhotos:
    """The photos' likelihood as a function of the light's code and the regions' mean colours (LightLikelihood).

    z (3, k + R): k coefficients of the code (the code itself, or with a basis (M, k) and mean (3, M) the code is mean +
    basis z), then log mean colours, scaled so that N(0, width^2) makes N(BRIGHTNESS_PRIOR, COLOUR_SPREAD^2): light and
    colours trade against each other and must move together. The exact prior of the colours is part of `value`.
    """

    def __init__(self, photos: Photos, prior, log_scale: float, width: float, basis=None):
        self.photos, self.prior, self.log_scale, self.width, self.basis = photos, prior, log_scale, width, basis

    @property
    def size(self) -> int:
        return self.prior.height * self.prior.width if self.basis is None else self.basis.shape[1]

    def join(self, code: torch.Tensor, theta: Theta) -> torch.Tensor:
        """z of coefficients (3, k) and colours."""
        log_mu = torch.from_numpy(np.log(theta.mu).T.astype(np.float32))
        return torch.cat([code, (log_mu - BRIGHTNESS_PRIOR[0]) * (self.width / COLOUR_SPREAD)], 1)

    def centre(self, code: torch.Tensor) -> torch.Tensor:
        """What z is drawn about, for coefficients (3, k) drawn about `code`."""
        return torch.cat([code, torch.zeros(3, len(self.photos.theta.m))], 1)

    def colours(self, z: torch.Tensor) -> np.ndarray:
        """(R, 3)"""
        return np.exp(z[:, self.size:].T.numpy().astype(np.float64) * (COLOUR_SPREAD / self.width) + BRIGHTNESS_PRIOR[0])

    def code(self, z: torch.Tensor) -> torch.Tensor:
        """(3, M)"""
        return z[:, :self.size] if self.basis is None else self.prior.flat_mean + z[:, :self.size] @ self.basis.T

    def radiance(self, code: torch.Tensor) -> torch.Tensor:
        """(3, M) of a code (3, M)"""
        shape = (1, 3, self.prior.height, self.prior.width)
        return float(np.exp(self.log_scale)) * self.prior.decode(code.reshape(shape)).reshape(3, -1)

    def light(self, code: torch.Tensor) -> np.ndarray:
        """(M, 3)"""
        return self.radiance(code).T.numpy().astype(np.float64)

    def value(self, z: torch.Tensor) -> float:
        theta = self.photos.theta.copy()
        theta.mu = self.colours(z)
        prior = log_prior(theta).sum()
        if not np.isfinite(prior):
            return -np.inf
        self.photos.set(theta)
        return self.photos.value(self.light(self.code(z))) + prior + 0.5 * float(z[:, self.size:].square().sum()) / self.width**2

    def expansion(self, z: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Gauss-Newton."""
        theta = self.photos.theta.copy()
        theta.mu = np.minimum(self.colours(z), 0.97)
        self.photos.set(theta)
        with torch.enable_grad():
            leaf = self.code(z).clone().requires_grad_(True)
            L = self.radiance(leaf)
            g, = torch.autograd.grad(L.sum(), leaf)                          # decoding is elementwise
        L = L.detach()
        T, y, V = self.photos.whitened(L.T.numpy().astype(np.float64))
        residual = y - torch.einsum("cnm,cm->cn", T, L)
        T *= g[:, None, :]
        return torch.cat([T if self.basis is None else T @ self.basis, V * (COLOUR_SPREAD / self.width)], 2), residual


def start_materials(fit: Explanation, uv: np.ndarray, region: np.ndarray, starts: np.ndarray, levels) -> Theta:
    """Region medians of the fit's maps."""
    at = uv[starts]
    values = {n: gather(np.ascontiguousarray(getattr(fit, n)), at).reshape(len(at), -1) for n in ("base_color", "roughness", "metallic")}
    count = region.max() + 1
    median = lambda v, r: np.median(v[region == r], axis=0)
    mu = np.clip(np.stack([median(values["base_color"], r) for r in range(count)]), 0.02, 0.95)
    level = np.array([np.abs(np.array(levels) - median(values["roughness"], r)).argmin() for r in range(count)])
    m = np.array([METALLIC[np.abs(METALLIC - median(values["metallic"], r)).argmin()] for r in range(count)])
    return Theta(mu, np.full(count, 0.3), level, m)


class Chain:
    """The state of one draw."""

    def __init__(self, problem: Problem, prior, fit: Explanation, settings: Sample, seed: int):
        self.rng, self.noise = generators(settings, seed)
        self.prior, self.settings, self.obs = prior, settings, problem.observations
        scene = problem.renderer.scene
        rows = choose_rows(self.obs, scene, settings.points, settings.views, settings.seed)
        starts = rows.starts
        rgb = self.obs.rgb[rows.observation]
        mean = np.add.reduceat(rgb, starts) / np.diff(np.append(starts, len(rgb)))[:, None]
        region, self.centers = group(mean)
        transport = Transport(scene, problem.renderer.mesh, self.obs, rows, prior.height, round(NODES * len(starts)), settings.seed)
        lobes = Lobes(transport, problem.roughness_min, settings.seed)
        self.photos = Photos(transport, lobes, rgb, self.obs.clipped[rows.observation], region, problem.renderer.max_depth - 1)
        self.theta = start_materials(fit, self.obs.uv[rows.observation], region, starts, lobes.levels)
        self.width = np.full(len(self.theta.m), 0.05)
        self.centre = self.log_scale = float(np.log(scale_of(fit.light)))
        self.coded = CodedPhotos(self.photos, prior, self.log_scale, FIRST)
        light = self.search()
        self.photos.set(self.theta)
        for _ in range(3):
            self.materials(light, WARM_UP // 3)
        colour, U, W = self.colour(light)
        residual = (self.photos.y - colour[rows.point] * U - W) * np.sqrt(self.photos.precision)
        neighbours = design_effect(rows, transport.position, self.obs.view[rows.observation], residual.mean(1))
        self.photos.kappa = channel_effect(residual) * neighbours

    def search(self) -> np.ndarray:
        """Materials to start from, by evidence; the light (M, 3) that goes with them."""
        self.gaussian = load_prior(self.settings.search_prior)
        search = Search(self.photos, self.gaussian, self.log_scale, self.settings.search_points, self.rng)
        self.theta, self.start_coefficients = search.run(self.theta, self.settings.search_tries, self.rng)
        code = search.code(self.start_coefficients)
        self.start_code = code.reshape(1, 3, self.prior.height, self.prior.width)
        return self.coded.light(code)

    def colour(self, light: np.ndarray):
        U, W = self.photos.predict(light)
        return self.photos.draw_colour(U, W, self.theta, self.rng), U, W

    def materials(self, light: np.ndarray, steps: int) -> None:
        """Region materials, then the points' colours and the noise given them."""
        nodes = self.photos.nodes(light, self.theta)
        lobes = self.photos.lobes.apply(light, nodes)
        self.theta = draw_regions(self.photos, lobes, self.theta, steps, self.rng, self.width)
        self.photos.set(self.theta)
        colour, U, W = self.colour(light)
        self.photos.draw_noise(U, W, colour, self.rng)

    def light_turn(self, coded: CodedPhotos, about: torch.Tensor, z: torch.Tensor) -> torch.Tensor:
        """Code (or coefficients) drawn about `about` together with the regions' colours; new coefficients (3, k)."""
        z = draw_light(coded, coded.centre(about), coded.join(z, self.theta), coded.width, SLICES, self.rng, self.noise)
        self.theta.mu = coded.colours(z)
        self.photos.set(self.theta)
        return z[:, :coded.size]

    def turns_with_gaussian(self, count: int, prior) -> torch.Tensor:
        """Light | rest with the Gaussian prior's components, in closed form but for the value code; the code (3, M)."""
        coded = CodedPhotos(self.photos, prior, self.log_scale, 1.0, prior.basis(COMPONENTS))
        c, nothing = self.start_coefficients, torch.zeros(3, COMPONENTS)
        with torch.no_grad():
            for _ in range(count):
                c = self.light_turn(coded, nothing, c)
                self.materials(coded.light(coded.code(c)), self.settings.region_steps)
        return coded.code(c)

    def gauge(self, z: torch.Tensor, x: torch.Tensor, rho: float) -> torch.Tensor:
        """Light against base colour; returns z."""
        U, W = self.photos.predict(self.coded.light(z))
        spread = self.prior.log_spread                                        # d log radiance / d code
        gap, count = (z - x).mean(1).numpy(), z.shape[1]
        pull = lambda d: float(-0.5 * count * ((gap + d / spread) ** 2 - gap**2).sum() / rho**2)
        self.theta, self.log_scale, shift = draw_gauge(self.photos, U, W, self.theta, self.log_scale, self.centre, pull, 60, self.rng)
        self.photos.set(self.theta)
        self.coded.log_scale = self.log_scale
        return z + torch.from_numpy((shift / spread).astype(np.float32))[:, None]

    def run(self, seed: int) -> torch.Tensor:
        """All turns; the light's code (1, 3, h, w)."""
        s, prior = self.settings, self.prior
        rhos = widths(s.levels, FIRST, LAST, s.stay)
        with torch.no_grad(), Bar(f"sample {seed}", len(rhos)) as bar:
            shape = (1, 3, prior.height, prior.width)
            z = self.start_code.reshape(3, -1)
            x = reverse_diffusion(prior, self.start_code, FIRST, prior_steps(FIRST), s.label, self.rng, self.noise)
            for rho in map(float, rhos):
                flat, self.coded.width = x.reshape(3, -1), rho
                z = self.gauge(self.light_turn(self.coded, flat, z), flat, rho)
                self.materials(self.coded.light(z), s.region_steps)
                x = reverse_diffusion(prior, z.reshape(shape), rho, prior_steps(rho), s.label, self.rng, self.noise)
                bar.step(f"error {100 * self.photos.eta:.1f} %")
        return x

    def maps(self, light: np.ndarray, size: int) -> dict:
        """Texture maps: a drawn colour per point spread over its texels, roughness and metallic by region."""
        colour, _, _ = self.colour(light.reshape(-1, 3).astype(np.float64))
        rows = self.photos.rows
        total = splat(self.obs.uv[rows.observation], np.concatenate([colour[rows.point], np.ones((len(rows.point), 1))], 1), size)
        known = total[..., 3] > 0.05
        region = texel_regions(self.obs, self.centers, size)
        base = fill(total[..., :3] / np.maximum(total[..., 3:], 1e-6), known)
        levels = np.array(self.photos.lobes.levels)
        return {"base_color": np.clip(cv2.GaussianBlur(base, (0, 0), 1.0), 0, 1).astype(np.float32),
                "roughness": levels[self.theta.level][region].astype(np.float32), "metallic": self.theta.m[region].astype(np.float32)}


    def result(self, code: torch.Tensor, start: Explanation) -> tuple[Explanation, dict]:
        """The draw as maps, and facts."""
        photos, theta, h = self.photos, self.theta, self.prior.height
        light = self.coded.radiance(code.reshape(3, -1)).T.reshape(h, 2 * h, 3).numpy().astype(np.float32)
        facts = {"scale": float(np.exp(self.log_scale)), "scale_drawn": True, "rows": len(photos.rows.point),
                 "points": len(photos.region), "relative_error": photos.eta, "design_effect": photos.kappa,
                 "regions": [{"base_color": theta.mu[r].tolist(), "spread": float(theta.tau[r]), "metallic": float(theta.m[r]),
                              "roughness": photos.lobes.levels[theta.level[r]], "points": int((photos.region == r).sum())}
                             for r in range(len(theta.m))]}
        return replace(start, light=np.ascontiguousarray(light), **self.maps(light, self.settings.texture)), facts


def split_gibbs(problem: Problem, prior, start: Explanation, settings: Sample, seed: int) -> tuple[Explanation, dict]:
    """One posterior sample; `start` is the fit. Deterministic in `seed`: independent of other samples and of the process."""
    chain = Chain(problem, prior, start, settings, seed)
    return chain.result(chain.run(seed), start)


def gaussian(problem: Problem, prior, start: Explanation, settings: Sample, seed: int) -> tuple[Explanation, dict]:
    """One posterior sample under the Gaussian prior `settings.search_prior`; `prior` gives the size of the light only."""
    chain = Chain(problem, prior, start, settings, seed)
    chain.prior = chain.gaussian
    chain.coded = CodedPhotos(chain.photos, chain.prior, chain.log_scale, 1.0)
    return chain.result(chain.turns_with_gaussian(max(settings.stay, 1), chain.prior), start)
