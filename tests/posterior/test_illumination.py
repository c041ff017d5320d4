"""Penalties of a light in closed form, harmonics as they are, and what each does to an optimum."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch

from pipeline.base.config import Sample
from pipeline.posterior.fit import FIRST_CANDIDATE, LightOptimizer
from pipeline.posterior.illumination.deep_image import NetworkLight
from pipeline.posterior.illumination.descent import descend, penalised
from pipeline.posterior.illumination.harmonics import HarmonicLight
from pipeline.posterior.illumination.penalties import (
    PENALTIES,
    chromaticity,
    global_norm,
    total_variation,
)
from pipeline.render.envmap import directions, sh_basis, solid_angles, yaw_roll
from pipeline.render.renderer import Explanation, Gradient
from tests.seeds import numpy_rng


def grey(values: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(np.repeat(values[..., None], 3, -1).astype(np.float32))


def test_global_norm_is_the_mean_square_over_the_sphere():
    y = directions(64, 128)[..., 1]
    assert float(global_norm(grey(1 + y))) == pytest.approx(1 + 1 / 3, abs=1e-3)  # E y^2 = 1/3


def test_total_variation_on_the_sphere():
    """Of L = y = sin(latitude): the mean of |cos| by solid angle, pi / 4. A turned light has the
    same, and one step all the way round counts its circle's length."""
    y = directions(128, 256)[..., 1]
    assert float(total_variation(grey(y))) == pytest.approx(np.pi / 4, rel=0.02)
    x = directions(64, 128)[..., 0]
    light = grey(2 + x)
    turned = torch.from_numpy(yaw_roll(light.numpy(), 17).copy())
    assert float(total_variation(turned)) == pytest.approx(float(total_variation(light)), rel=1e-5)

    cap = grey((directions(128, 256)[..., 1] > 0.5).astype(float))
    circle = 2 * np.pi * np.sqrt(0.75) / (4 * np.pi)  # length over the sphere's area
    assert float(total_variation(cap)) == pytest.approx(circle, rel=0.03)


def test_chromaticity_of_a_colour():
    light = torch.ones(8, 16, 3) * torch.tensor([1.6, 1.0, 0.4])
    assert float(chromaticity(light)) == pytest.approx(0.4, abs=2e-3)  # (.6 + 0 + .6) / 3
    assert float(chromaticity(grey(numpy_rng(0).random((8, 16))))) < 1e-6


@pytest.mark.parametrize("name", PENALTIES)
def test_slopes_are_differences(name):
    rng = numpy_rng(1)
    light = rng.uniform(0.5, 2, (8, 16, 3)).astype(np.float32)
    value, slope = penalised(PENALTIES[name], light, 1.3)
    step = rng.normal(size=light.shape).astype(np.float32)
    ends = [penalised(PENALTIES[name], light + e * step, 1.3)[0] for e in (-2e-4, 2e-4)]
    assert value > 0
    # beside its usual size: along a random step a slope's parts nearly cancel at times
    usual = float(np.linalg.norm(slope))
    assert (slope * step).sum() == pytest.approx((ends[1] - ends[0]) / 4e-4, abs=0.03 * usual)


def test_harmonics_are_orthonormal_and_keep_their_light():
    basis = sh_basis(64, 128)
    products = np.einsum("ihw,jhw,hw->ij", basis, basis, solid_angles(64, 128))
    np.testing.assert_allclose(products, np.eye(9), atol=2e-3)

    true = 1 + 0.4 * directions(64, 128) @ np.array([[0.3, 0, 0.2], [1, 0.5, 0], [0, 0.2, 1]])
    light = HarmonicLight(true.astype(np.float32), 0.01)
    np.testing.assert_allclose(light.light(), true, atol=5e-3)


def test_harmonics_descend_to_a_light_of_their_kind():
    """Least squares towards a smooth light ends there."""
    d = directions(16, 32)
    true = np.repeat((1 + 0.5 * d[..., :1] - 0.3 * d[..., 1:2]), 3, -1).astype(np.float32)
    light = HarmonicLight(np.ones((16, 32, 3), np.float32), 0.02)
    weight = solid_angles(16, 32)[..., None]
    for _ in range(400):
        now = light.light()
        light.step(2 * (now - true) * weight, now)
    np.testing.assert_allclose(light.light(), true, atol=0.02)


def test_an_untrained_network_begins_constant_and_draws_what_is_smooth_before_noise():
    """Ulyanov et al. 2018, their Fig. 2: as many steps bring it far nearer to a smooth light than
    to noise of the same variance. It repeats by its seed, and no global random number is drawn."""
    d = directions(16, 32)
    weight = solid_angles(16, 32)[..., None]
    smooth = np.repeat(np.exp(d[..., :1] - 0.5 * d[..., 1:2]), 3, -1).astype(np.float32)
    deviation = np.log(smooth).std()
    noisy = np.exp(numpy_rng(0).normal(0, deviation, smooth.shape)).astype(np.float32)

    def left_over(true: np.ndarray) -> tuple[float, np.ndarray]:
        """Squared error of log radiance after the steps, over what it was."""
        light = NetworkLight(np.ones((16, 32, 3), np.float32), 0.02, torch.Generator())
        first = light.light()
        np.testing.assert_array_equal(first, 1)
        for _ in range(15):
            now = light.light()
            light.step(2 * np.log(now / true) / now * weight, now)
        end = light.light()
        error = lambda value: (np.log(value / true) ** 2 * weight).sum()
        return error(end) / error(first), end

    state = torch.random.get_rng_state()
    of_smooth, end = left_over(smooth)
    of_noise, _ = left_over(noisy)
    assert of_smooth < 0.1
    assert of_noise > 0.3
    np.testing.assert_array_equal(left_over(smooth)[1], end)
    assert torch.equal(torch.random.get_rng_state(), state)


def test_a_descent_returns_its_best_state_by_data_term_and_prior():
    """The light only grows; the data term falls up to radiance 1.5 and rises after it, and a prior
    of darker light asks for less."""
    flat = np.zeros((8, 8), np.float32)
    begin = Explanation(np.ones((4, 8, 3), np.float32), np.stack([flat] * 3, -1), flat, flat)
    settings = Sample(steps=200)

    def gradient(x: Explanation, batch: None, seed: int) -> Gradient:
        loss = (float(x.light.mean()) - 1.5) ** 2
        return Gradient(-np.ones_like(x.light), 0 * x.base_color, flat, flat, loss)

    problem = SimpleNamespace(batch=lambda *sizes: None, gradient=gradient, roughness_min=0.0)

    def returned(weight: float) -> tuple[float, dict]:
        light = LightOptimizer(begin.light, 2 * settings.learning_rate)
        darker = lambda radiance: (weight * float(radiance.mean()), 0.0)
        x, facts = descend(problem, begin, light, settings, 0, numpy_rng(0), darker)
        assert light.light().mean() > 2 and facts["loss_last"] > facts["loss"]
        return float(x.light.mean()), facts

    plain, facts = returned(0.0)
    assert plain == pytest.approx(1.5, abs=0.2) and facts["best_step"] > FIRST_CANDIDATE
    assert returned(0.5)[0] < plain - 0.1
