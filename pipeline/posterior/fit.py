"""Point estimate of light and materials together (DPI, Eq. 15): Adam through the path tracer.

Gauge: (light, albedo) -> (s light, albedo / s) leaves diffuse pictures unchanged. The fit starts
with a median observed base colour of ALBEDO_START and drifts from there only as far as the photos
(specular light, interreflection) ask.
"""

from __future__ import annotations

import numpy as np
import torch

from pipeline.base.config import Fit
from pipeline.base.images import luminance
from pipeline.base.progress import Bar
from pipeline.posterior.adam import Adam
from pipeline.posterior.material_optimizer import BETAS, MaterialOptimizer
from pipeline.posterior.problem import Problem, renderer_seed
from pipeline.posterior.seen_light import SeenLight
from pipeline.render.renderer import Explanation

ALBEDO_START = 0.35
ROUGHNESS_START = 0.5
METALLIC_START = 0.05
FIRST_CANDIDATE = (
    20  # step; the running mean of the loss has nearly forgotten the first loss by then
)
SEEN_WEIGHT = 0.1  # of what is seen of the light, beside the data term


class LightOptimizer:
    """The light as exp(parameter) under Adam: it stays positive, and steps are relative."""

    def __init__(self, light: np.ndarray, learning_rate: float):
        self.log_light = torch.from_numpy(np.log(light))
        self.adam = Adam([self.log_light], [learning_rate], BETAS)

    def light(self) -> np.ndarray:
        """Radiance (h, 2h, 3)."""
        return torch.exp(self.log_light).numpy()

    def step(self, slope: np.ndarray, light: np.ndarray) -> None:
        """One step of Adam, for the loss's `slope` in the radiance at `light`."""
        self.log_light.grad = torch.from_numpy(np.ascontiguousarray(slope * light))
        self.adam.step()

    def set_learning_rate(self, learning_rate: float) -> None:
        self.adam.set_learning_rate(learning_rate)


class BestState:
    """The explanation with the least running mean of the loss: a single step's loss is that of a
    few pixels, and noisy. The first of the `steps` are no candidates (FIRST_CANDIDATE); until one
    comes, the first state is kept.
    """

    def __init__(self, steps: int):
        self.first_candidate = min(FIRST_CANDIDATE, steps // 2)
        self.running_mean: float | None = None
        self.step = 0
        self._least = np.inf
        self._explanation: Explanation | None = None

    @property
    def loss(self) -> float | None:
        """The least running mean; that of all steps where there is no candidate."""
        return self._least if np.isfinite(self._least) else self.running_mean

    @property
    def explanation(self) -> Explanation:
        """The best so far. Raises ValueError before the first step is seen."""
        if self._explanation is None:
            raise ValueError("no step has been seen yet")
        return self._explanation

    def see(self, step: int, explanation: Explanation, loss: float) -> None:
        """Take one more step's state."""
        if self.running_mean is None:
            self.running_mean = loss
            self._explanation = explanation.copy()
            return

        self.running_mean = 0.9 * self.running_mean + 0.1 * loss
        if step >= self.first_candidate and self.running_mean < self._least:
            self._least = self.running_mean
            self.step = step
            self._explanation = explanation.copy()


def start(problem: Problem, texture: int) -> Explanation:
    """Grey, rough, non-metallic, under a constant light that makes the median pixel right."""
    brightness = float(np.median(luminance(problem.observations.rgb)))
    radiance = max(brightness, 1e-4) / ALBEDO_START
    gloss_map = lambda value: np.full((texture, texture), value, np.float32)
    return Explanation(
        np.full(problem.renderer.light_shape, radiance, np.float32),
        np.full((texture, texture, 3), ALBEDO_START, np.float32),
        gloss_map(ROUGHNESS_START),
        gloss_map(METALLIC_START),
    )


def fit(problem: Problem, settings: Fit, seed: int = 0) -> tuple[Explanation, dict]:
    """Returns the best explanation and {"loss_start", "loss_end", "best_step"}. seed: of pixels and
    paths.

    Eq. 15 (published): x, k = argmin over x, k of sum_i || y_i - R(x, k, c_i) ||^2

    for light x, materials k, photos y_i from cameras c_i and renderer R; Adam with learning rate
    0.01 on the pixels of x and k.

    Ours: the sum runs over random pixels of all views; the error is relative with a floor, and
    one-sided where a photo is saturated (problem.py); Adam moves log x instead of x; its rate falls
    tenfold over the run, for a constant one diverges late; the gradient's noise is made independent
    of the residual's (render/renderer.py, crossed_adjoint); what photos show of the light itself
    pulls at it (seen_light.py); the state returned is the one with the least running mean of the
    loss, not the last.
    """
    rng = np.random.default_rng(seed)
    first = start(problem, settings.texture)
    materials = MaterialOptimizer(first, settings.learning_rate, problem.roughness_min)
    light = LightOptimizer(first.light, settings.learning_rate)
    seen = SeenLight.of(problem.observations.surroundings.sightings, len(first.light))
    best = BestState(settings.steps)
    losses = []

    with Bar("fit", settings.steps) as bar:
        for step in range(settings.steps):
            rate = settings.learning_rate * 0.1 ** (step / settings.steps)
            materials.set_learning_rate(rate)
            light.set_learning_rate(rate)

            explanation = materials.explanation(light.light())
            batch = problem.batch(settings.pixels, settings.spp, rng)
            gradient = problem.gradient(explanation, batch, renderer_seed(rng))
            best.see(step, explanation, gradient.loss)

            pull = seen.slope(explanation.light.reshape(-1, 3)).reshape(first.light.shape)
            light.step(gradient.light + SEEN_WEIGHT * pull, explanation.light)
            materials.step(gradient)
            losses.append(gradient.loss)
            bar.step(f"loss {best.running_mean:.4f}")

    return best.explanation, {
        "loss_start": losses[0],
        "loss_end": best.loss,
        "best_step": best.step,
    }
