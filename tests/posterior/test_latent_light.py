"""A generator's light under Adam: its scale, its slope, and inversion of a light that it made."""

import numpy as np
import pytest
import torch

from pipeline.base.config import Sample
from pipeline.base.errors import InputError
from pipeline.posterior.check_settings import check_settings
from pipeline.posterior.illumination.latent import LatentLight
from pipeline.prior.generators import load_generator
from pipeline.render.envmap import mean_radiance, solid_angles
from tests.seeds import numpy_rng, torch_rng

pytestmark = pytest.mark.usefixtures("one_thread")
NAMES = ("gan_latent", "equivariant_field")


def latents(generator, seed: int) -> torch.Tensor:
    return torch.randn((1, *generator.latents), generator=torch_rng(seed))


@pytest.mark.parametrize("name", NAMES)
def test_it_begins_at_its_level_and_repeats_at_more_rows(name):
    generator = load_generator(name)
    for height in (32, 64):
        light = LatentLight(generator, latents(generator, 1), height, 3.5, 0.0, 0.01).light()
        assert light.shape == (height, 2 * height, 3)
        assert float(mean_radiance(light).mean()) == pytest.approx(3.5, rel=1e-4)


@pytest.mark.parametrize("name", NAMES)
def test_its_slope_is_that_of_loss_and_prior(name):
    """Against difference quotients of sum(slope * light) + weight * mean(z^2)."""
    generator = load_generator(name)
    z = latents(generator, 1)
    light = LatentLight(generator, z, 32, 1.0, 0.7, 0.0)
    slope = numpy_rng(0).normal(size=(32, 64, 3)).astype(np.float32) / 6144
    light.step(slope, light.light())
    along = latents(generator, 2)

    def value(step: float) -> float:
        moved = LatentLight(generator, z, 32, 1.0, 0.7, 0.0)
        with torch.no_grad():
            moved.log_scale.copy_(light.log_scale)
            moved.z += step * along
        return float((slope * moved.light()).sum() + 0.7 * moved.z.detach().square().mean())

    quotient = (value(2e-3) - value(-2e-3)) / 4e-3
    assert float((light.z.grad * along).sum()) == pytest.approx(quotient, rel=0.03, abs=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_inversion_comes_near_a_light_that_the_generator_made(name):
    """Least squares in log radiance; a draw of the prior is as far from another as z = 0 is, or
    farther."""
    generator = load_generator(name)
    true = LatentLight(generator, latents(generator, 3), 32, 2.0, 0.0, 0.05).light()
    light = LatentLight(generator, torch.zeros(1, *generator.latents), 32, 1.0, 0.0, 0.05)
    weight = solid_angles(32, 64)[..., None] / (12 * np.pi)
    error = lambda now: float((np.log(now / true) ** 2 * weight).sum())
    first = error(light.light())
    for _ in range(150):
        now = light.light()
        light.step(2 * np.log(now / true) / now * weight, now)
    assert error(light.light()) < 0.3 * first


@pytest.mark.slow
def test_latents_without_photos_go_to_zero():
    generator = load_generator("gan_latent")
    light = LatentLight(generator, latents(generator, 4), 32, 1.0, 1.0, 0.05)
    for _ in range(200):
        light.step(np.zeros((32, 64, 3)), light.light())
    assert float(light.z.detach().square().mean()) < 1e-3


def test_a_prior_of_other_rows_is_refused_before_anything_is_drawn():
    """The adversarial network makes 32 rows or a multiple; the field makes any."""
    settings = Sample(method="gan_latent", prior="prior_tiny")
    with pytest.raises(InputError, match="a multiple of 32 rows, not of the prior's 16"):
        check_settings(settings)
    check_settings(settings.model_copy(update={"method": "equivariant_field"}))
    check_settings(settings.model_copy(update={"prior": "prior_small"}))
