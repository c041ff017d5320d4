import numpy as np
import pytest
import torch

from pipeline.envmap import mean_radiance, solid_angles
from pipeline.errors import InputError
from pipeline.prior import find_prior, load_prior
from pipeline.prior.code import Code, scale_of
from pipeline.prior.network import Denoiser
from pipeline.prior.procedural import night, outdoor
from pipeline.prior.schedule import T, posterior, sigma, subsequence


def lights():
    rng = np.random.default_rng(3)
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
    torch.manual_seed(0)
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
    assert levels[0] == T - 1 and levels[-1] == 0 and len(levels) == 37 and (np.diff(levels) < 0).all()


def test_trained_prior_removes_noise_better_than_doing_nothing():
    prior = load_prior("prior_small")
    light = outdoor(np.random.default_rng(11), prior.height, prior.width)
    x = prior.encode(light / scale_of(light))
    torch.manual_seed(0)
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
