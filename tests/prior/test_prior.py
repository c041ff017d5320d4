import numpy as np
import pytest
import torch

from pipeline.base.errors import InputError
from pipeline.prior.load import find_prior, load_gaussian, load_prior
from pipeline.prior.network import Denoiser
from pipeline.prior.sampling import (
    GUIDANCE,
    GUIDED_FROM,
    GUIDED_TO,
    Guided,
    classes,
    reverse_diffusion,
)
from pipeline.prior.schedule import T, posterior, sigma, subsequence
from pipeline.prior.training.procedural import night, outdoor
from pipeline.prior.value_code import Code, scale_of
from pipeline.render.envmap import mean_radiance, solid_angles
from tests.seeds import numpy_rng, seeded, torch_rng


def lights():
    rng = numpy_rng(3)
    yield from (f(rng, 16, 32) for f in (outdoor, night, outdoor))
    sun = np.full((16, 32, 3), 0.2)
    sun[5, 7] = 20000
    yield sun


def test_code_keeps_energy_and_peaks():
    code = Code(-0.5, 1.3)
    for light in lights():
        light = light / scale_of(light)
        back = code.decode(code.encode(light))[0].numpy().transpose(1, 2, 0)
        assert back.min() >= 0
        assert np.allclose(mean_radiance(back), mean_radiance(light), rtol=0.005)
        assert np.isclose(back.max(), light.max(), rtol=1e-3)


def test_network_has_no_seam():
    """Rolling the input by any number of columns that the pooling allows rolls the output."""
    torch.manual_seed(seeded(0))
    net = Denoiser(channels=(8, 16, 16), blocks=(1, 1, 1), embedding=16).eval()
    for p in net.parameters():
        torch.nn.init.normal_(p, std=0.1)
    x = torch.randn(1, 3, 8, 16)
    args = torch.tensor([0.7]), torch.tensor([4])
    with torch.no_grad():
        assert torch.allclose(net(x.roll(4, -1), *args), net(x, *args).roll(4, -1), atol=1e-5)


def test_ddpm_posterior_reaches_the_clean_end():
    a, b, deviation = posterior(10, -1)
    assert np.isclose(a, 1) and np.isclose(b, 0) and np.isclose(deviation, 0)


def test_ddpm_posterior_keeps_the_marginal():
    """x_s drawn from q(x_s | x_t, x_0) has the variance of level s (strided steps too)."""
    t, s = 800, 300
    from pipeline.prior.schedule import ALPHA_BAR

    a, b, deviation = posterior(t, s)
    assert np.isclose(a + b * np.sqrt(ALPHA_BAR[t]), np.sqrt(ALPHA_BAR[s]))
    assert np.isclose(b**2 * (1 - ALPHA_BAR[t]) + deviation**2, 1 - ALPHA_BAR[s])


def test_levels_run_from_last_to_first():
    levels = subsequence(37)
    assert (
        levels[0] == T - 1 and levels[-1] == 0 and len(levels) == 37 and (np.diff(levels) < 0).all()
    )


def test_trained_prior_removes_noise_better_than_doing_nothing():
    prior = load_prior("prior_small")
    light = outdoor(numpy_rng(11), prior.height, prior.width)
    x = prior.encode(light / scale_of(light))
    torch.manual_seed(seeded(0))
    noisy = x + sigma(300) * torch.randn_like(x)
    with torch.no_grad():
        clean = prior.denoise(noisy, sigma(300))
    weight = torch.from_numpy(solid_angles(prior.height, prior.width).copy())
    error = lambda y: float((((y - x) ** 2).mean((0, 1)) * weight).sum())
    assert error(clean) < 0.25 * error(noisy)


def test_wrong_weights_are_named(tmp_path):
    wrong = tmp_path / "wrong.safetensors"
    wrong.write_bytes(b"not a tensor file")
    with pytest.raises(InputError, match="not a Heliograph light prior"):
        load_prior(str(wrong))
    with pytest.raises(InputError, match="prior_small"):
        find_prior("prior_smal")
    with pytest.raises(InputError, match="no class"):
        load_prior("prior_small").label_index("seaside")


def test_classes_come_in_their_shares():
    shares = {"indoor": 0.2, "outdoor": 0.5, "night": 0.3}
    ten = classes(shares, 10, numpy_rng(0))
    assert [ten.count(name) for name in shares] == [2, 5, 3]
    eleven = classes(shares, 11, numpy_rng(0))
    assert len(eleven) == 11 and all(
        abs(eleven.count(name) - 11 * share) < 1 for name, share in shares.items()
    )


def test_noise_is_denoised_class_by_class():
    prior, x = (
        load_prior("prior_small"),
        torch.randn(2, 3, 32, 64, generator=torch_rng(0)),
    )
    both = prior.denoise(x, 2.0, ["night", None])
    assert torch.allclose(both[:1], prior.denoise(x[:1], 2.0, "night"), atol=1e-4)
    assert torch.allclose(both[1:], prior.denoise(x[1:], 2.0), atol=1e-4)
    assert not torch.allclose(both[:1], prior.denoise(x[:1], 2.0), atol=1e-2)


class Shrinking:
    """Codes N(m, .25) pixel by pixel, m = 1 with the class and 0 without: what every step of
    reverse diffusion should give is known.
    """

    height, width, shares = 4, 8, {}

    def denoise(self, x, sigma, label=None):
        return (0.25 * x + sigma**2 * (label is not None)) / (0.25 + sigma**2)


@pytest.mark.parametrize("churn", [0.0, 0.5, 1.0])
def test_reverse_diffusion_draws_the_prior_with_any_churn(churn):
    noise = torch_rng(0)
    z = 20 * torch.randn(400, 3, 4, 8, generator=noise)
    x = reverse_diffusion(Shrinking(), z, 20.0, 40, "class", numpy_rng(0), noise, churn=churn)
    assert abs(float(x.mean()) - 1) < 0.03 and abs(float(x.std()) - 0.5) < 0.03


def test_guidance_leads_away_from_the_unlabelled_mean():
    prior, x = Shrinking(), torch.zeros(1, 3, 4, 8)
    middle = 0.5 * (GUIDED_FROM + GUIDED_TO)
    assert torch.allclose(
        Guided(prior).denoise(x, middle, "class"), GUIDANCE * prior.denoise(x, middle, "class")
    )
    for sigma_ in (0.5 * GUIDED_FROM, 2 * GUIDED_TO):
        assert torch.equal(
            Guided(prior).denoise(x, sigma_, "class"), prior.denoise(x, sigma_, "class")
        )


def test_a_network_is_no_gaussian_prior():
    """`sample.start_prior` naming a network ends in a message that says what to name instead."""
    assert load_gaussian("gaussian_tiny").height == 16
    with pytest.raises(InputError, match="gaussian_small"):
        load_gaussian("prior_tiny")
