"""`dpi_paper`, `dpi_code` and `sds` against slow references of their own, to rounding.

The references are written from the paper and the design note (`method.md`, sections 2 and 3) in
float64, on a problem of which every derivative is known: a renderer that is linear in light and
materials, and a Gaussian prior, whose denoiser is linear as well. They share the stream of random
numbers with the samplers, and nothing else: schedule, posterior, losses, gradients and Adam are
written out again.
"""

from types import SimpleNamespace

import numpy as np
import pytest
import torch
from scipy import ndimage

from pipeline.base.config import Sample
from pipeline.posterior.dpi.as_published import dpi_paper
from pipeline.posterior.dpi.as_released import dpi_code
from pipeline.posterior.dpi.score_distillation import sds
from pipeline.posterior.problem import Problem
from pipeline.prior.value_code import Code
from pipeline.render.renderer import Explanation, Gradient
from tests.seeds import numpy_rng, seeded

H, W, TEXTURE, VIEWS, PIXELS, SPP = 4, 8, 8, 3, 16, 2
CODES = 3 * H * W
ROUGHNESS_MIN = 0.1
MEAN_LOG, SPREAD_LOG = -0.4, 1.2  # of log radiance; Code's `mean` and twice its `std`
PARTS = ("light", "base_color", "roughness", "metallic")


class World:
    """A scene of 60 observed pixels in three views: L = light T + base_color P + roughness q +
    metallic s, and a prior N(mean, covariance) of codes in which no two pixels are alike.
    """

    def __init__(self, clipped_share: float = 0.2):
        rng = numpy_rng(0)
        n, texels = 60, TEXTURE**2
        self.T = rng.uniform(0, 2, (n, H * W)) / (H * W)
        self.P = rng.uniform(0, 1, (n, texels)) / texels
        self.q, self.s = rng.normal(size=(2, n, texels)) / texels
        self.rgb = rng.uniform(0.5, 4, (n, 3)).astype(np.float32)
        self.clipped = rng.random((n, 3)) < clipped_share
        self.view = rng.integers(VIEWS, size=n)
        root = rng.normal(size=(CODES, 2 * CODES)) * 0.5 / np.sqrt(2 * CODES)
        self.covariance = root @ root.T
        self.mean = rng.normal(size=CODES) * 0.3
        field = lambda *shape: rng.uniform(0.2, 0.8, (TEXTURE, TEXTURE) + shape).astype(np.float32)
        light = rng.uniform(0.2, 3, (H, W, 3)).astype(np.float32)
        self.start = Explanation(light, field(3), field(), field())

    def radiance(self, index, x) -> np.ndarray:
        """L (n, 3) of pixels `index` for a dict or an Explanation x."""
        light, color, roughness, metallic = (np.asarray(part, np.float64) for part in parts(x))
        grey = self.q[index] @ roughness.ravel() + self.s[index] @ metallic.ravel()
        return (
            self.T[index] @ light.reshape(-1, 3)
            + self.P[index] @ color.reshape(-1, 3)
            + grey[:, None]
        )

    def pulled_back(self, index, slope) -> dict:
        """Derivatives of a loss in all parts, from its derivative in L (n, 3)."""
        square = (TEXTURE, TEXTURE)
        return {
            "light": (self.T[index].T @ slope).reshape(H, W, 3),
            "base_color": (self.P[index].T @ slope).reshape(square + (3,)),
            "roughness": (self.q[index].T @ slope.sum(1)).reshape(square),
            "metallic": (self.s[index].T @ slope.sum(1)).reshape(square),
        }

    def shrink(self, sigma: float) -> np.ndarray:
        """K (codes, codes) of the denoiser mean + K (x - mean)."""
        return self.covariance @ np.linalg.inv(self.covariance + sigma**2 * np.eye(CODES))


def parts(x):
    return [x[name] if isinstance(x, dict) else getattr(x, name) for name in PARTS]


class LinearRenderer:
    """The interface of `Renderer.gradient`; rays carry the number of their pixel."""

    def __init__(self, world: World):
        self.world, self.seeds = world, []

    def gradient(self, x, o, d, pixels, dloss, seed) -> Gradient:
        assert o.shape == d.shape == (SPP, pixels, 3)
        self.seeds.append(seed)
        index = o[0, :, 0].astype(int)
        loss, slope = dloss(self.world.radiance(index, x))
        back = self.world.pulled_back(index, slope)
        return Gradient(*(back[name].astype(np.float32) for name in PARTS), loss)


class LinearPrior:
    """The world's Gaussian prior as the samplers see it."""

    height, width, log_spread = H, W, SPREAD_LOG

    def __init__(self, world: World):
        self.world, self.decode = world, Code(MEAN_LOG, SPREAD_LOG / 2).decode
        self.labels = set()

    def denoise(self, x, sigma, label=None):
        self.labels.add(label)
        K = torch.from_numpy(self.world.shrink(sigma)).float()
        mean = torch.from_numpy(self.world.mean).float()
        return (mean + K @ (x.reshape(-1) - mean)).reshape(x.shape)


def rays(index, rng):
    o = np.zeros(index.shape + (3,))
    o[..., 0] = index
    return o, rng.random(index.shape + (3,))


def problem_of(world: World) -> Problem:
    class Pixels(SimpleNamespace):
        def __len__(self):
            return len(self.rgb)

    pixels = Pixels(
        rgb=world.rgb, clipped=world.clipped, view=world.view, views=[None] * VIEWS, rays=rays
    )
    return Problem(pixels, LinearRenderer(world), ROUGHNESS_MIN)


class Reference:
    """What all three algorithms are made of, written out in float64."""

    def __init__(self, world: World, settings: Sample, seed: int):
        self.world, self.settings = world, settings
        self.rng = np.random.default_rng([0, seeded(seed)])
        self.noise = torch.Generator().manual_seed(seeded(seed))
        self.alpha_bar = np.cumprod(1 - np.linspace(1e-4, 0.02, 1000))
        colatitude = np.pi * np.arange(H + 1) / H
        ring = (np.cos(colatitude[:-1]) - np.cos(colatitude[1:])) / 2
        self.scale = (np.sqrt(world.start.light.mean(-1)).mean(1) @ ring) ** 2
        self.values = {n: getattr(world.start, n).astype(float) for n in PARTS[1:]}
        self.moments = {n: [0.0, 0.0] for n in PARTS[1:]}
        self.steps = 0

    def normal(self) -> np.ndarray:
        return torch.randn((1, 3, H, W), generator=self.noise).numpy()[0].astype(float)

    def levels(self) -> list[tuple[int, int]]:
        """Pairs of a level of the thousand and the next one down, -1 after the last."""
        t = np.linspace(999, 0, self.settings.steps).round().astype(int).tolist()
        return list(zip(t, t[1:] + [-1]))

    def sigma(self, t: int) -> float:
        return np.sqrt(1 / self.alpha_bar[t] - 1)

    def denoised(self, x, sigma) -> np.ndarray:
        m = self.world.mean
        return (m + self.world.shrink(sigma) @ (x.ravel() - m)).reshape(3, H, W)

    def radiance(self, code) -> np.ndarray:
        """Light (H, W, 3) of a code (3, H, W)."""
        return (self.scale * np.exp(SPREAD_LOG * code + MEAN_LOG)).transpose(1, 2, 0)

    def batch(self, view=None) -> np.ndarray:
        """Indices of the pixels of a step; their jitter is drawn and not used."""
        if view is None:
            index = self.rng.integers(len(self.world.rgb), size=PIXELS)
        else:
            index = self.rng.choice(np.flatnonzero(self.world.view == view), PIXELS)
        self.rng.random((SPP, PIXELS, 3))
        return index

    def step_seed(self) -> None:
        """A draw that the renderer's seed takes."""
        self.rng.integers(1 << 31)

    def next_code(self, x, x0, t: int, s: int) -> np.ndarray:
        """x_s from its distribution given x_t and x_0: two normal densities multiplied."""
        if s < 0:
            return x0
        ab_s, a = self.alpha_bar[s], self.alpha_bar[t] / self.alpha_bar[s]
        precision = 1 / (1 - ab_s) + a / (1 - a)
        mean = (np.sqrt(ab_s) * x0 / (1 - ab_s) + np.sqrt(a) * x / (1 - a)) / precision
        return mean + self.normal() / np.sqrt(precision)

    def adam(self, value, moments, slope, rate, step, second) -> np.ndarray:
        """Kingma and Ba (2015), Algorithm 1; `moments` changes in place."""
        moments[0] = 0.9 * moments[0] + 0.1 * slope
        moments[1] = second * moments[1] + (1 - second) * slope**2
        first, square = moments[0] / (1 - 0.9**step), moments[1] / (1 - second**step)
        return value - rate * first / (np.sqrt(square) + 1e-8)

    def move_materials(self, slopes: dict, rates: dict, code: bool = False) -> None:
        """A step of Adam into the valid sets; roughness and metallic move as smooth fields. code:
        as released, without either limit above of base colour or smoothing.
        """
        self.steps += 1
        low = {"base_color": 0, "roughness": ROUGHNESS_MIN, "metallic": 0}
        high = {"base_color": np.inf if code else 0.98, "roughness": 1, "metallic": 1}
        second = 0.999 if code else 0.99
        for n in PARTS[1:]:
            slope = slopes[n]
            if n != "base_color" and not code:
                slope = ndimage.gaussian_filter(slope, 0.5, mode="mirror", radius=2)
            moved = self.adam(self.values[n], self.moments[n], slope, rates[n], self.steps, second)
            self.values[n] = np.clip(moved, low[n], high[n])

    def relative_loss(self, index, light) -> tuple[float, dict]:
        """Mean square of (L - y) / (y + 0.1), nothing where a saturated pixel is exceeded; and its
        derivatives.
        """
        y = self.world.rgb[index].astype(float)
        r = (self.world.radiance(index, {"light": light} | self.values) - y) / (y + 0.1)
        r = np.where(self.world.clipped[index] & (r > 0), 0, r)
        return (r**2).mean(), self.world.pulled_back(index, 2 * r / (y + 0.1) / r.size)

    def norm_loss(self, index, light, indoor: bool) -> dict:
        """Derivatives of |L - y|, of |log(1 + L) - log(1 + y)| indoors."""
        y = self.world.rgb[index].astype(float)
        L = self.world.radiance(index, {"light": light} | self.values)
        r = np.log((1 + L) / (1 + y)) if indoor else L - y
        r = np.where(self.world.clipped[index] & (r > 0), 0, r)
        slope = r / np.sqrt((r**2).sum())
        return self.world.pulled_back(index, slope / (1 + L) if indoor else slope)

    def square_loss(self, index, light) -> dict:
        """Derivatives of the mean of (L - y)^2."""
        y = self.world.rgb[index].astype(float)
        r = self.world.radiance(index, {"light": light} | self.values) - y
        r = np.where(self.world.clipped[index] & (r > 0), 0, r)
        return self.world.pulled_back(index, 2 * r / r.size)

    def to_code(self, slope, radiance) -> np.ndarray:
        """Derivative in the code (3, H, W) from that in the light (H, W, 3)."""
        return (slope * radiance * SPREAD_LOG).transpose(2, 0, 1)

    def through_denoiser(self, slope, t: int) -> np.ndarray:
        """Derivative in x_t of what has `slope` in x_0."""
        K = self.world.shrink(self.sigma(t))
        return (K.T @ slope.ravel()).reshape(3, H, W) / np.sqrt(self.alpha_bar[t])

    def result(self, code) -> dict:
        return {"light": self.radiance(code)} | self.values


def published(world, settings, seed) -> tuple[dict, set]:
    """Lyu et al. (2023), Eqs. 7, 13, 16 and 19, with this project's calibration of rho and limits
    of a step; which limits were met.
    """
    r, met = Reference(world, settings, seed), set()
    r.values["base_color"] *= 0
    x = r.normal()
    for t, s in r.levels():
        columns = int(r.rng.integers(W))
        x = np.roll(x, columns, 2)
        x0 = r.denoised(x / np.sqrt(r.alpha_bar[t]), r.sigma(t))
        light = np.roll(r.radiance(x0), -columns, 1)
        index = r.batch()
        r.step_seed()
        loss, slopes = r.relative_loss(index, light)

        slope = np.roll(r.to_code(slopes["light"], light), columns, 2)
        gradient = r.through_denoiser(slope, t) / (2 * np.sqrt(loss))
        weight = 0.1 if t > 500 else 1 - 0.9 * t / 500
        move = 30 / 2048 * H * W * settings.guidance * weight * 1000 / settings.steps * gradient
        size = np.sqrt((move**2).mean())
        if size > 0.25:
            met.add("whole")
            move *= 0.25 / size
        if np.abs(move).max() > 0.5:
            met.add("pixel")
        x = np.roll(r.next_code(x, x0, t, s) - np.clip(move, -0.5, 0.5), -columns, 2)
        r.move_materials(slopes, dict.fromkeys(PARTS[1:], settings.learning_rate))
    return r.result(x), met


def released(world, settings, seed) -> dict:
    """The authors' code, design note section 3, in codes of four deviations to its range [0, 1]."""
    r, indoor = Reference(world, settings, seed), settings.label == "indoor"
    r.values["base_color"] = np.full((TEXTURE, TEXTURE, 3), 0.01)
    x = r.normal()
    for t, s in r.levels():
        columns = int(r.rng.integers(3)) if t / 1000 < 0.9 else 0
        x = np.roll(x, columns, 2)
        x0 = r.denoised(x / np.sqrt(r.alpha_bar[t]), r.sigma(t))
        shake = torch.rand((1, 3, H, W), generator=r.noise).numpy()[0]
        light = np.roll(r.radiance(x0 + 2 * 0.05 * shake), -columns, 1)
        first, second = r.rng.integers(VIEWS, size=2)
        guide, other = r.batch(first), r.batch(second)

        r.step_seed()
        slope = r.to_code(r.norm_loss(guide, light, indoor)["light"], light)
        gradient = r.through_denoiser(np.roll(slope, columns, 2), t)
        while np.abs(gradient).max() > 0.1:
            gradient = gradient / 10
        time = t / 1000
        if indoor:
            weight = 0.01 if time >= 0.9 else 0.1 if time >= 0.5 else 1.0
        else:
            weight = 0.01 if time >= 0.9 else np.interp(time, [0, 0.5, 0.9], [0.2, 1.0, 0.1])
        x = np.roll(r.next_code(x, x0, t, s) - 2 * weight * gradient, -columns, 2)

        r.step_seed()
        slopes = r.square_loss(other, np.roll(r.radiance(x0), -columns, 1))
        rates = {"base_color": 0.02, "roughness": 0.015, "metallic": 0.01}
        r.move_materials(slopes, rates, code=True)
        if int(t / 1000 * 1000 + 1e-9) % 1.5 == 0:
            for n in ("base_color", "roughness"):
                r.values[n] = r.values[n] / r.values[n].max()
    r.values["base_color"] = np.minimum(r.values["base_color"], 1)
    return r.result(x)


def distilled(world, settings, seed) -> dict:
    """Score distillation (Poole et al. 2023): Adam along data term and eps_hat - eps."""
    r = Reference(world, settings, seed)
    x, moments = 0.5 * r.normal(), [0.0, 0.0]
    for k in range(settings.steps):
        light = r.radiance(x)
        index = r.batch()
        r.step_seed()
        _, slopes = r.relative_loss(index, light)
        sigma = r.sigma(int(r.rng.integers(20, 600)))
        eps = r.normal()
        noisy = x + sigma * eps
        eps_hat = (noisy - r.denoised(noisy, sigma)) / sigma
        score = 0.02 / CODES * sigma / max(sigma, 0.1) * (eps_hat - eps)
        slope = r.to_code(slopes["light"], light) + score
        x = r.adam(x, moments, slope, 2 * settings.learning_rate, k + 1, 0.999)
        r.move_materials(slopes, dict.fromkeys(PARTS[1:], settings.learning_rate))
    return r.result(x)


def settings(**changes) -> Sample:
    base = {
        "steps": 20,
        "pixels": PIXELS,
        "spp": SPP,
        "texture": TEXTURE,
        "learning_rate": 0.02,
    }
    return Sample(**(base | changes))


def assert_alike(found: Explanation, expected: dict) -> None:
    """To what float32 leaves over after all steps."""
    for name, value in zip(PARTS, parts(found)):
        assert value.std() > 1e-4, name
        np.testing.assert_allclose(value, expected[name], rtol=3e-5, atol=3e-6, err_msg=name)


@pytest.mark.parametrize("guidance, limits", [(0.01, set()), (30.0, {"whole", "pixel"})])
def test_dpi_paper_is_the_published_algorithm(guidance, limits):
    world, chosen = World(), settings(guidance=guidance)
    expected, met = published(world, chosen, 3)
    problem = problem_of(world)
    found, _ = dpi_paper(problem, LinearPrior(world), world.start, chosen, seeded(3))
    assert_alike(found, expected)
    assert len(set(problem.renderer.seeds)) == chosen.steps
    assert met == limits


@pytest.mark.parametrize("label", ["indoor", "outdoor"])
@pytest.mark.parametrize("steps", [2, 20, 52])
def test_dpi_code_is_the_released_algorithm(label, steps):
    """52 steps include one that divides base colour and roughness by their largest value."""
    world, chosen = World(), settings(label=label, steps=steps)
    problem = problem_of(world)
    prior = LinearPrior(world)
    assert_alike(
        dpi_code(problem, prior, world.start, chosen, seeded(3))[0], released(world, chosen, 3)
    )
    assert prior.labels == {label}
    assert len(set(problem.renderer.seeds)) == 2 * steps


@pytest.mark.slow
def test_sds_is_score_distillation():
    world, chosen = World(), settings()
    problem = problem_of(world)
    found, _ = sds(problem, LinearPrior(world), world.start, chosen, seeded(3))
    assert_alike(found, distilled(world, chosen, 3))
    assert len(set(problem.renderer.seeds)) == chosen.steps
