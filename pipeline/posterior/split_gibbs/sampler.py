"""`split_gibbs`: one posterior draw of light and materials from the transport operator and the
diffusion prior.

Set-up: rows of the photos over the surface (transport.py), regions of like colour, the noise and
its design effect from the residuals of the fit. Then the turns of turns.py, each followed by moves
of materials, scale and noise.
"""

from __future__ import annotations

from copy import deepcopy
from dataclasses import replace

import cv2
import numpy as np
import torch
from scipy.spatial import cKDTree

from pipeline.base.config import Sample
from pipeline.posterior.problem import ALBEDO_MAX, Problem, generators
from pipeline.posterior.split_gibbs.light_codes import Coded, PixelCode
from pipeline.posterior.split_gibbs.likelihood import (
    LEVELS,
    METALLIC,
    Lobes,
    Photos,
    Theta,
    channel_effect,
    contrast,
    design_effect,
    metallic_step,
)
from pipeline.posterior.split_gibbs.material_moves import (
    categorical,
    draw_gauge,
    draw_offsets,
    draw_regions,
    propose,
    propose_colour,
    propose_spread,
)
from pipeline.posterior.split_gibbs.regions import group, texel_regions
from pipeline.posterior.split_gibbs.start_search import THINNING, Search
from pipeline.posterior.split_gibbs.turns import LAST, Turns
from pipeline.posterior.textures import fill, gather, splat
from pipeline.prior.load import load_prior
from pipeline.prior.value_code import scale_of
from pipeline.render.renderer import Explanation
from pipeline.render.rows import choose_rows
from pipeline.render.transport import Transport

# from either start, every row counted in full: what they leave over shows the noise's correlation
GAUSSIAN_TURNS = 2
# then with the design effect: the last turns that move the light's level freely, so with the errors
# it has
THINNED_TURNS = 1
# region steps at the search's light, for colours and noise: it is too smooth to say anything of
# gloss
WARM_UP = 150
BLOCKS, SHAPE = (
    12,
    2.0,
    # pieces of surface that err together; of their gamma weights: half the variance of a full
    # bootstrap, the draws' own adds to it
)
# of the texture's side: roughness and metallic of the points run into each other over as much
SOFT = 64
SHARES = (
    0.6,
    0.97,
    # of the spread of colours that regions explain, drawn afresh: nobody knows how many materials
    # there are, nor where one ends
)
NODES = 0.5  # radiosity nodes beside the points, as a share of their number


def start_materials(
    fit: Explanation, uv: np.ndarray, region: np.ndarray, starts: np.ndarray, lobes: Lobes
) -> Theta:
    """Region medians of the fit's maps, no more metallic than their roughness can be."""
    at = uv[starts]
    values = {
        n: gather(np.ascontiguousarray(getattr(fit, n)), at).reshape(len(at), -1)
        for n in ("base_color", "roughness", "metallic")
    }
    count = region.max() + 1
    median = lambda v, r: np.median(v[region == r], axis=0)
    mu = np.clip(np.stack([median(values["base_color"], r) for r in range(count)]), 0.02, 0.95)
    level = np.array(
        [
            np.abs(np.array(lobes.levels) - median(values["roughness"], r)).argmin()
            for r in range(count)
        ]
    )
    m = METALLIC[
        metallic_step(
            np.array([median(values["metallic"], r) for r in range(count)]).reshape(count)
        )
    ]
    return Theta(mu, np.full(count, 0.3), level, np.minimum(m, lobes.most_metallic[level]))


def sharpest(normal_error: float) -> float:
    """Roughness of the sharpest lobe that normals of this median error (radians) can show.

    Facets tilted by sigma per axis are a surface of alpha^2 = 2 sigma^2 (Beckmann; Olano and Baker
    2010: variances of slopes add), alpha = roughness^2. A sharper lobe on such normals mirrors
    another part of the light at every point, and so explains anything.
    """
    sigma = normal_error / np.sqrt(
        2 * np.log(2)
    )  # the median length of two normal deviates is 1.18 sigma
    return float(min((np.sqrt(2) * sigma) ** 0.5, LEVELS[-2]))


def block_shares(position: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """How much each point (p, 3) counts in this draw, mean 1: the same within a block of surface,
    gamma between blocks.
    """
    blocks = cKDTree(
        position[rng.choice(len(position), min(BLOCKS, len(position)), replace=False)]
    ).query(position)[1]
    share = rng.gamma(SHAPE, size=blocks.max() + 1)[blocks]
    return share / share.mean()


class Chain(Turns):
    """Turns for the light, with materials, scale and noise unknown."""

    def __init__(self, problem: Problem, prior, fit: Explanation, settings: Sample, seed: int):
        rng, noise = generators(settings, seed)
        self.obs, scene, own = (
            problem.observations,
            problem.renderer.scene,
            settings.seed + 1000 * seed,
        )
        rows = choose_rows(self.obs, scene, settings.points, settings.views, own)
        starts = rows.starts
        rgb, clipped = rows.patch @ self.obs.rgb, rows.patch @ self.obs.clipped > 0
        region, centers = group(
            gather(fit.base_color, self.obs.uv[rows.observation[starts]]),
            rng.uniform(*SHARES),
            int(rng.integers(2**31)),
        )
        self.region_map = texel_regions(fit.base_color, centers, settings.texture)
        transport = Transport(
            scene,
            problem.renderer.mesh,
            self.obs,
            rows,
            settings.light,
            round(NODES * len(starts)),
            own,
        )
        lobes = Lobes(transport, max(problem.roughness_min, sharpest(problem.normal_error)), own)
        photos = Photos(transport, lobes, rgb, clipped, region, problem.renderer.max_depth - 1)
        photos.share, photos.ceiling = (
            block_shares(transport.position[starts], rng),
            ALBEDO_MAX / contrast(rows, self.obs.rgb),
        )
        theta = start_materials(fit, self.obs.uv[rows.observation], region, starts, lobes)
        self.width, self.spread_width = (np.full(len(theta.m), 0.05) for _ in range(2))
        self.centre = float(np.log(scale_of(fit.light)))
        super().__init__(
            photos,
            theta,
            self.centre,
            prior,
            load_prior(settings.search_prior),
            settings,
            rng,
            noise,
        )

    def thin(self, light: np.ndarray) -> None:
        """Measure how many rows stand for one independent one, from the residuals under this
        light.
        """
        photos, rows = self.photos, self.photos.rows
        colour, U, W = self.colour(light)
        residual = (photos.observed - colour[rows.point] * U - W) * np.sqrt(
            photos.counted(U, W, self.theta)
        )
        neighbours = design_effect(
            rows, photos.transport.position, self.obs.view[rows.observation], residual.mean(1)
        )
        photos.kappa = channel_effect(residual) * neighbours

    def begin(self, theta: Theta, code: torch.Tensor) -> tuple[float, tuple[dict, dict]]:
        """First turns from materials and a code (3, m) of the Gaussian prior: how well they explain
        the rows, and the state they end in.
        """
        photos, coded = self.photos, self.gaussian_code()
        self.theta, self.coefficients = theta, coded.coefficients(code)
        photos.set(theta)
        for _ in range(3):
            self.materials(coded.light(code), WARM_UP // 3, propose_colour)
        code = self.turns_with_gaussian(GAUSSIAN_TURNS)
        colour, U, W = self.colour(self.gaussian_code().light(code))
        return photos.log_noise(U, W, colour) / THINNING, self.state()

    def state(self) -> tuple[dict, dict]:
        """Copies of all that turns change, to go on from later by `resume`."""
        own, photos = (
            ("theta", "log_scale", "coefficients", "width", "spread_width"),
            ("eta", "weight", "offset"),
        )
        return deepcopy({name: getattr(self, name) for name in own}), deepcopy(
            {name: getattr(self.photos, name) for name in photos}
        )

    def resume(self, state: tuple[dict, dict]) -> None:
        """Back to a `state`; one that is used once only."""
        for owner, values in zip((self, self.photos), state):
            vars(owner).update(values)
        self.photos.set(self.theta)

    def colour(self, light: np.ndarray):
        U, W = self.photos.predict(light)
        return self.photos.draw_colour(U, W, self.theta, self.rng), U, W

    def materials(self, light: np.ndarray, steps: int, proposal=propose) -> None:
        """Region materials, then the points' colours and the noise given them."""
        nodes = self.photos.nodes(light, self.theta)
        lobes = self.photos.lobes.apply(light, nodes)
        self.theta = draw_regions(
            self.photos, lobes, self.theta, steps, self.rng, self.width, proposal
        )
        if proposal is propose:
            draw_offsets(self.photos, lobes, self.theta, self.rng)
        with self.photos.row_by_row():
            self.theta = draw_regions(
                self.photos,
                lobes,
                self.theta,
                steps // 3,
                self.rng,
                self.spread_width,
                propose_spread,
            )
            self.photos.set(self.theta)
            colour, U, W = self.colour(light)
            self.photos.draw_noise(U, W, colour, self.rng)

    def start(self, turns: int) -> torch.Tensor:
        """A draw under the Gaussian prior as a code (3, M) of the diffusion prior: from the
        materials that the search found, those which explain the rows best after some turns, then
        `turns` more with thinned rows.
        """
        search = Search(
            self.photos, self.gaussian, self.log_scale, self.settings.search_points, self.rng
        )
        fresh, found = self.state(), search.run(self.theta, self.settings.search_sweeps, self.rng)
        tried = []
        for theta, c in found:
            self.resume(deepcopy(fresh))
            tried.append(self.begin(theta, search.coded.code(c)))
        self.resume(tried[categorical(np.array([[value for value, _ in tried]]), self.rng)[0]][1])
        coded = self.gaussian_code()
        self.thin(coded.light(coded.code(self.coefficients)))
        return self.handed_over(self.turns_with_gaussian(turns))

    def after_light(self, coded: Coded, code: torch.Tensor, shifts=None) -> torch.Tensor:
        """Scale and materials given the light; the code, moved if `shifts` says what a move
        costs.
        """
        light = coded.light(code)
        U, W = self.photos.predict(light)
        pull = shifts or (lambda d: 0.0 if not d.any() else -np.inf)
        self.theta, self.log_scale, shift = draw_gauge(
            self.photos, U, W, self.theta, self.log_scale, self.centre, pull, 60, self.rng
        )
        self.photos.set(self.theta)
        coded.log_scale = self.log_scale
        code = code + torch.from_numpy((shift / coded.prior.log_spread).astype(np.float32))[:, None]
        self.materials(coded.light(code), self.settings.region_steps)
        return code

    def run(self, seed: int) -> torch.Tensor:
        """All turns; the light's code (3, M)."""
        with torch.no_grad():
            return self.diffusion_turns(self.start(THINNED_TURNS), f"sample {seed}")

    def maps(self, light: np.ndarray, size: int) -> dict:
        """Texture maps: a drawn colour per point spread over its texels; roughness and metallic by
        region, and how far points lie from that spread over their texels.
        """
        colour, _, _ = self.colour(light)
        rows, region, levels = (
            self.photos.rows,
            self.photos.region,
            np.array(self.photos.lobes.levels),
        )
        level, m = self.photos.point_materials(self.theta)
        regions = {"roughness": levels[self.theta.level], "metallic": self.theta.m}
        beside = np.stack(
            [levels[level] - regions["roughness"][region], m - regions["metallic"][region]], 1
        )
        values = np.concatenate([colour, beside, np.ones((len(colour), 1))], 1)
        total = splat(self.obs.uv[rows.observation], values[rows.point], size)
        known = total[..., 5] > 0.05
        spread = fill(total[..., :5] / np.maximum(total[..., 5:], 1e-6), known)
        base, beside = (
            cv2.GaussianBlur(spread[..., :3], (0, 0), 1.0),
            cv2.GaussianBlur(spread[..., 3:], (0, 0), max(size / SOFT, 0.5)),
        )
        bounds = {"roughness": (levels[0], levels[-1]), "metallic": (0, 1)}
        out = {
            name: np.clip(regions[name][self.region_map] + beside[..., k], *bounds[name])
            for k, name in enumerate(bounds)
        }
        return {
            name: value.astype(np.float32)
            for name, value in (out | {"base_color": np.clip(base, 0, 1)}).items()
        }

    def result(self, code: torch.Tensor, start: Explanation) -> tuple[Explanation, dict]:
        """The draw as maps, and facts."""
        photos, theta = self.photos, self.theta
        coded = PixelCode(photos, self.prior, self.log_scale, LAST)
        facts = {
            "scale": float(np.exp(self.log_scale)),
            "scale_drawn": True,
            "rows": len(photos.rows.point),
            "points": len(photos.region),
            "relative_error": photos.eta,
            "design_effect": photos.kappa,
            "sharpest_roughness": photos.lobes.levels[0],
            "regions": [
                {
                    "base_color": theta.mu[r].tolist(),
                    "spread": float(theta.tau[r]),
                    "metallic": float(theta.m[r]),
                    "roughness": photos.lobes.levels[theta.level[r]],
                    "points": int((photos.region == r).sum()),
                }
                for r in range(len(theta.m))
            ],
        }
        return replace(
            start, light=coded.map(code), **self.maps(coded.light(code), self.settings.texture)
        ), facts


def split_gibbs(
    problem: Problem, prior, start: Explanation, settings: Sample, seed: int
) -> tuple[Explanation, dict]:
    """One posterior sample; `start` is the fit. Deterministic in `seed`: independent of other
    samples and of the process.
    """
    chain = Chain(problem, prior, start, settings, seed)
    return chain.result(chain.run(seed), start)


def gaussian(
    problem: Problem, prior, start: Explanation, settings: Sample, seed: int
) -> tuple[Explanation, dict]:
    """One posterior sample under the Gaussian prior `settings.search_prior`; `prior` gives the size
    of the light only.
    """
    chain = Chain(problem, prior, start, settings, seed)
    with torch.no_grad():
        return chain.result(chain.start(GAUSSIAN_TURNS), start)
