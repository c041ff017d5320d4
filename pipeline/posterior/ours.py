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
from ..prior.gaussian import translated
from ..prior.sampling import reverse_diffusion
from ..progress import Bar
from ..transport import Transport, choose_rows
from .coded import Coded, ModeCode, Modes, PixelCode
from .evidence import COMPONENTS, Search
from .likelihood import Lobes, Photos, Theta, channel_effect, design_effect
from .problem import Problem, generators
from .refine import fill, gather, splat
from .region_moves import METALLIC, draw_gauge, draw_regions, propose_spread
from .regions import group, texel_regions
from .split_gibbs import SLICES, draw_light, noise_gain, prior_steps, widths

FIRST, LAST = 0.15, 0.02    # widths of the splitting in code units, where the prior's deviation is 0.5; above, log radiance is far from linear
SMOOTH = 0.7                # noise level of the first smooth turn: hides all but the largest shapes
GAUSSIAN_TURNS = 3          # every row counted in full: what they leave over shows the noise's correlation
WARM_UP = 150               # region steps at the fit's light, for the noise and as the start
NODES = 0.5                 # radiosity nodes beside the points, as a share of their number


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
        rgb, clipped = rows.patch @ self.obs.rgb, rows.patch @ self.obs.clipped > 0
        mean = np.add.reduceat(rgb, starts) / np.diff(np.append(starts, len(rgb)))[:, None]
        region, self.centers = group(mean)
        transport = Transport(scene, problem.renderer.mesh, self.obs, rows, settings.light, round(NODES * len(starts)), settings.seed)
        lobes = Lobes(transport, problem.roughness_min, settings.seed)
        self.photos = Photos(transport, lobes, rgb, clipped, region, problem.renderer.max_depth - 1)
        self.theta = start_materials(fit, self.obs.uv[rows.observation], region, starts, lobes.levels)
        self.width, self.spread_width = (np.full(len(self.theta.m), 0.05) for _ in range(2))
        self.centre = self.log_scale = float(np.log(scale_of(fit.light)))
        light = self.search()
        self.photos.set(self.theta)
        for _ in range(3):
            self.materials(light, WARM_UP // 3)

    def thin(self, light: np.ndarray) -> None:
        """Measure how many rows stand for one independent one, from the residuals under this light."""
        photos, rows = self.photos, self.photos.rows
        colour, U, W = self.colour(light)
        residual = (photos.y - colour[rows.point] * U - W) * np.sqrt(photos.precision)
        neighbours = design_effect(rows, photos.transport.position, self.obs.view[rows.observation], residual.mean(1))
        photos.kappa = channel_effect(residual) * neighbours

    def search(self) -> np.ndarray:
        """Materials to start from, by evidence; the light (M', 3) that goes with them."""
        self.gaussian = load_prior(self.settings.search_prior)
        search = Search(self.photos, self.gaussian, self.log_scale, self.settings.search_points, self.rng)
        self.theta, self.coefficients = search.run(self.theta, self.settings.search_sweeps, self.rng)
        return search.light(self.coefficients[0])

    def colour(self, light: np.ndarray):
        U, W = self.photos.predict(light)
        return self.photos.draw_colour(U, W, self.theta, self.rng), U, W

    def materials(self, light: np.ndarray, steps: int) -> None:
        """Region materials, then the points' colours and the noise given them."""
        nodes = self.photos.nodes(light, self.theta)
        lobes = self.photos.lobes.apply(light, nodes)
        self.theta = draw_regions(self.photos, lobes, self.theta, steps, self.rng, self.width)
        with self.photos.row_by_row():
            self.theta = draw_regions(self.photos, lobes, self.theta, steps // 3, self.rng, self.spread_width, propose_spread)
            self.photos.set(self.theta)
            colour, U, W = self.colour(light)
            self.photos.draw_noise(U, W, colour, self.rng)

    def light_turn(self, coded: Coded, about: torch.Tensor, z: torch.Tensor) -> torch.Tensor:
        """Unknowns of the light's code drawn about `about` together with the regions' colours, from z on."""
        z = draw_light(coded, coded.centre(about), coded.join(z, self.theta), coded.width, SLICES, self.rng, self.noise)
        self.theta.mu = coded.colours(z)
        self.photos.set(self.theta)
        return z[:, :coded.size]

    def turns_with_gaussian(self, count: int) -> torch.Tensor:
        """Light | rest with the Gaussian prior's modes; the code (3, m) in that prior's units."""
        modes = Modes(self.gaussian, self.gaussian, COMPONENTS, self.photos.transport.h)
        coded = ModeCode(self.photos, self.gaussian, self.log_scale, modes, self.gaussian.flat_mean)
        for _ in range(count):
            self.coefficients = self.light_turn(coded, torch.zeros(1, coded.size), self.coefficients)
            self.after_light(coded, coded.code(self.coefficients))
        return coded.code(self.coefficients)

    def start(self, turns: int = 0) -> torch.Tensor:
        """A draw under the Gaussian prior as a code (3, M) of the diffusion prior, after `turns` more with thinned rows."""
        g = self.gaussian
        code = self.turns_with_gaussian(GAUSSIAN_TURNS)
        self.thin(Coded(self.photos, g, self.log_scale, 1.0).light(code))
        code = self.turns_with_gaussian(turns) if turns else code
        return translated(code.reshape(1, 3, g.height, g.width), g, self.prior).reshape(3, -1)

    def after_light(self, coded: Coded, code: torch.Tensor, shifts=None) -> torch.Tensor:
        """Scale and materials given the light; the code, moved if `shifts` says what a move costs."""
        light = coded.light(code)
        U, W = self.photos.predict(light)
        pull = shifts or (lambda d: 0.0 if not d.any() else -np.inf)
        self.theta, self.log_scale, shift = draw_gauge(self.photos, U, W, self.theta, self.log_scale, self.centre, pull, 60, self.rng)
        self.photos.set(self.theta)
        coded.log_scale = self.log_scale
        code = code + torch.from_numpy((shift / coded.prior.log_spread).astype(np.float32))[:, None]
        self.materials(coded.light(code), self.settings.region_steps)
        return code

    def smooth_turns(self, code: torch.Tensor, sigmas, bar: Bar) -> torch.Tensor:
        """Decoupled annealing (DAPS, Zhang et al. 2025): noise on the code, the network's mean under it, and a draw about that mean
        with the covariance that the Gaussian prior has under the same noise. Code (3, M) in and out.
        """
        prior, modes = self.prior, Modes(self.gaussian, self.prior, COMPONENTS, self.photos.transport.h)
        for sigma in map(float, sigmas):
            noisy = (code + sigma * torch.randn(code.shape, generator=self.noise)).reshape(1, 3, prior.height, prior.width)
            mean = prior.denoise(noisy, sigma, self.settings.label).reshape(3, -1)
            coded = ModeCode(self.photos, prior, self.log_scale, modes, mean, sigma)
            c = self.light_turn(coded, torch.zeros(1, coded.size), coded.coefficients(code))
            code = self.after_light(coded, coded.code(c))
            bar.step(f"error {100 * self.photos.eta:.1f} %")
        return code

    def split_turns(self, code: torch.Tensor, rhos, bar: Bar) -> torch.Tensor:
        """Split Gibbs (split_gibbs.py): code (3, M) in, a draw of the prior side out."""
        prior, shape = self.prior, (1, 3, self.prior.height, self.prior.width)
        coded = PixelCode(self.photos, prior, self.log_scale, float(rhos[0]))
        z = code + float(rhos[0]) * torch.randn(code.shape, generator=self.noise)
        x = code
        for rho in map(float, rhos):
            coded.width, coded.gain = rho, noise_gain(prior.log_spread, rho)
            z = self.light_turn(coded, x, z)
            gap = (z - x).mean(1).numpy()
            cost = lambda d: float(-0.5 * z.shape[1] * ((gap + d / prior.log_spread) ** 2 - gap**2).sum() / rho**2)
            z = self.after_light(coded, z, cost)
            x = reverse_diffusion(prior, z.reshape(shape), rho, prior_steps(rho), self.settings.label, self.rng, self.noise).reshape(3, -1)
            bar.step(f"error {100 * self.photos.eta:.1f} %")
        return x

    def run(self, seed: int) -> torch.Tensor:
        """All turns; the light's code (1, 3, h, w)."""
        sigmas = np.geomspace(SMOOTH, FIRST, self.settings.smooth)
        rhos = widths(self.settings.levels, FIRST, LAST, self.settings.stay)
        with torch.no_grad(), Bar(f"sample {seed}", len(sigmas) + len(rhos)) as bar:
            return self.split_turns(self.smooth_turns(self.start(), sigmas, bar), rhos, bar)

    def maps(self, light: np.ndarray, size: int) -> dict:
        """Texture maps: a drawn colour per point spread over its texels, roughness and metallic by region."""
        colour, _, _ = self.colour(light)
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
        coded = PixelCode(photos, self.prior, self.log_scale, LAST)
        light = coded.radiance(code).T.reshape(h, 2 * h, 3).numpy().astype(np.float32)
        facts = {"scale": float(np.exp(self.log_scale)), "scale_drawn": True, "rows": len(photos.rows.point),
                 "points": len(photos.region), "relative_error": photos.eta, "design_effect": photos.kappa,
                 "regions": [{"base_color": theta.mu[r].tolist(), "spread": float(theta.tau[r]), "metallic": float(theta.m[r]),
                              "roughness": photos.lobes.levels[theta.level[r]], "points": int((photos.region == r).sum())}
                             for r in range(len(theta.m))]}
        return replace(start, light=np.ascontiguousarray(light), **self.maps(coded.light(code), self.settings.texture)), facts


def split_gibbs(problem: Problem, prior, start: Explanation, settings: Sample, seed: int) -> tuple[Explanation, dict]:
    """One posterior sample; `start` is the fit. Deterministic in `seed`: independent of other samples and of the process."""
    chain = Chain(problem, prior, start, settings, seed)
    return chain.result(chain.run(seed), start)


def gaussian(problem: Problem, prior, start: Explanation, settings: Sample, seed: int) -> tuple[Explanation, dict]:
    """One posterior sample under the Gaussian prior `settings.search_prior`; `prior` gives the size of the light only."""
    chain = Chain(problem, prior, start, settings, seed)
    with torch.no_grad():
        return chain.result(chain.start(GAUSSIAN_TURNS), start)
