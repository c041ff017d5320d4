"""The sampler against posteriors known in closed form."""

import numpy as np
import pytest
import torch
from scipy import stats

from pipeline.posterior.split_gibbs.gaussian_approximation import (
    Curvature,
    LightLikelihood,
    approximate,
)
from pipeline.posterior.split_gibbs.light_draw import SLICES, draw_light
from pipeline.posterior.split_gibbs.light_moves import prior_steps, widths
from pipeline.posterior.split_gibbs.pooling import Fold, Pool, Whole
from pipeline.posterior.split_gibbs.state import Randomness
from pipeline.prior.gaussian import OPPONENT, GaussianPrior, spectra
from pipeline.prior.sampling import reverse_diffusion
from pipeline.prior.value_code import Code
from tests.seeds import numpy_rng, torch_rng


@pytest.fixture
def gaussian():
    """A Gaussian prior over 4x8 codes with correlated pixels and a mean."""
    rng = numpy_rng(0)
    root = torch.from_numpy(rng.normal(size=(3, 5, 4, 4)) * 0.2).float()
    covariance = root @ root.transpose(-1, -2) + 0.02 * torch.eye(4)
    return GaussianPrior(torch.linspace(-0.3, 0.3, 12).reshape(3, 4), covariance, Code(-0.5, 1.3))


def dense(prior: GaussianPrior) -> torch.Tensor:
    """Covariance (96, 96) by applying it to every unit vector."""
    size = 3 * prior.height * prior.width
    return prior.filtered(
        torch.eye(size).reshape(size, 3, prior.height, prior.width), lambda v: v
    ).reshape(size, size)


class Linear(LightLikelihood):
    """y_c = J_c z_c + noise of deviation 1."""

    def __init__(self, J, y):
        self.J, self.y = J, y

    def value(self, z):
        return -0.5 * float(self.residual(z).square().sum())

    def residual(self, z):
        return self.y - torch.einsum("cnm,cm->cn", self.J, z)

    def expansion(self, z):
        return self.J, self.residual(z), Whole()


def randomness(seed) -> Randomness:
    return Randomness(numpy_rng(seed), torch_rng(seed))


def chains(prior, likelihood, rhos, count: int, seed: int) -> torch.Tensor:
    """`count` draws (count, 3 h w) side by side, as split_gibbs takes them, without materials.

    A chain is a channel of `draw_light`, for which channels are independent, of all its colours in
    a row. Their common slices keep them so only where `likelihood` is quadratic: then every slice
    is whole.
    """
    both = randomness(seed)
    rng, noise = both
    shape = (count, 3, prior.height, prior.width)
    first = 20 * torch.randn(shape, generator=noise)
    x = reverse_diffusion(prior, first, 20.0, 10, None, rng, noise)
    z = x.reshape(count, -1)
    for rho in map(float, rhos):
        z, _ = draw_light(both, likelihood, x.reshape(count, -1), z, rho, 2)
        x = reverse_diffusion(prior, z.reshape(shape), rho, prior_steps(rho), None, rng, noise)
    return x.reshape(count, -1)


def apart(prior, likelihood, rhos, count: int, seed: int) -> torch.Tensor:
    """`chains` for any likelihood: the light of every chain is drawn by itself, as one channel."""
    both = randomness(seed)
    rng, noise = both
    shape = (count, 3, prior.height, prior.width)
    first = 20 * torch.randn(shape, generator=noise)
    x = reverse_diffusion(prior, first, 20.0, 10, None, rng, noise)
    z = x.reshape(count, 1, -1)
    for rho in map(float, rhos):
        about = x.reshape(count, 1, -1)
        draw = lambda k: draw_light(both, likelihood, about[k], z[k], rho, 2)[0]  # noqa: B023
        z = torch.stack([draw(k) for k in range(count)])
        x = reverse_diffusion(prior, z.reshape(shape), rho, prior_steps(rho), None, rng, noise)
    return x.reshape(count, -1)


def whitened(draws: torch.Tensor, mean: torch.Tensor, covariance: torch.Tensor) -> torch.Tensor:
    """Draws (n, k) of N(mean, covariance) as draws of N(0, 1)."""
    root = torch.linalg.cholesky(covariance.double())
    return torch.linalg.solve_triangular(root, (draws - mean).double().T, upper=False).T


def assert_unit_covariance(white: torch.Tensor) -> None:
    """The covariance of whitened draws (n, k) is the identity: variances, all pairs and every
    direction.

    Of n draws, an entry off the diagonal has the variance 1 / n: their mean square in units of that
    may differ from 1 by five deviations of such a mean, 5 (2 / pairs)^1/2, at 66 pairs p < 1e-4.
    Extreme eigenvalues are held against Marchenko and Pastur's (1967).
    """
    n, k = white.shape
    covariance = torch.cov(white.T)
    variances = covariance.diagonal()
    off = covariance - torch.diag(variances)
    assert abs(float(variances.mean()) - 1) < 0.05
    assert float(variances.min()) > 1 - 5 * (2 / n) ** 0.5
    assert float(variances.max()) < 1 + 5 * (2 / n) ** 0.5
    pairs = k * (k - 1) / 2
    assert abs(float(off.square().sum() / (2 * pairs)) * n - 1) < 5 * (2 / pairs) ** 0.5

    eigenvalues = torch.linalg.eigvalsh(covariance)
    assert float(eigenvalues.max()) < 1.1 * (1 + (k / n) ** 0.5) ** 2
    assert float(eigenvalues.min()) > 0.9 * (1 - (k / n) ** 0.5) ** 2


def test_denoiser_is_the_conditional_mean(gaussian):
    """Closed form against dense linear algebra."""
    C = dense(gaussian)
    x, mean = (
        torch.randn(1, 3, 4, 8, generator=torch_rng(1)),
        gaussian.mean.expand(1, 3, 4, 8).reshape(-1),
    )
    expected = mean + C @ torch.linalg.solve(C + 0.49 * torch.eye(96), x.reshape(-1) - mean)
    assert torch.allclose(gaussian.denoise(x, 0.7).reshape(-1), expected, atol=1e-4)


def test_spectra_recover_the_covariance(gaussian):
    codes = gaussian.sample(4000, torch_rng(0)).numpy()
    mean, covariance = spectra(codes, np.ones(len(codes)))
    again = GaussianPrior(mean, covariance, gaussian.code)
    assert torch.allclose(OPPONENT @ OPPONENT.T, torch.eye(3), atol=1e-6)
    assert float((dense(again) - dense(gaussian)).norm() / dense(gaussian).norm()) < 0.1


def test_modes_span_the_covariance(gaussian):
    """All modes together give back the covariance, the leading ones the most of it."""
    B, variance = gaussian.modes(96)
    assert torch.allclose(
        torch.einsum("kcm,kdn->cmdn", B, B).reshape(96, 96), dense(gaussian), atol=1e-4
    )
    assert (
        torch.allclose(variance, B.square().sum((1, 2)), atol=1e-4)
        and (variance.diff() <= 1e-6).all()
    )


@pytest.mark.parametrize("n", [5, 40])
def test_curvature_solves_and_draws(n):
    """Both sides of Woodbury: solution and the covariance of the draws."""
    noise = torch_rng(0)
    J, s = torch.randn(n, 12, generator=noise), 0.4
    A = J.T @ J + torch.eye(12) / s**2
    curvature, b = Curvature.of(J, s), torch.randn(12, generator=noise)
    assert curvature.dual == (n < 12)
    assert torch.allclose(curvature.solve(b), torch.linalg.solve(A, b), atol=1e-4)
    draws = torch.stack([curvature.draw(noise) for _ in range(4000)])
    assert_unit_covariance(whitened(draws, torch.zeros(12), torch.linalg.inv(A)))


class Pooled(LightLikelihood):
    """y = T P exp(z) + noise of deviation 1, the light pooled from 8 to 4 rows; one more unknown at
    the end, observed as it is.
    """

    def __init__(self, folded: bool):
        noise = torch_rng(2)
        self.pool, self.T, self.folded = Pool(8, 4), torch.randn(3, 20, 32, generator=noise), folded
        self.y = torch.randn(3, 20, generator=noise)

    def value(self, z):
        return -0.5 * float(self.residual(z).square().sum())

    def residual(self, z):
        return (
            self.y
            - torch.einsum("cnm,cm->cn", self.T, self.pool.down(z[:, :128].exp()))
            - z[:, 128:]
        )

    def expansion(self, z):
        g, r = z[:, :128].exp(), self.residual(z)
        one = torch.ones(3, 20, 1)
        if self.folded:
            fold = Fold(self.pool, g, 1)
            return torch.cat([self.T * fold.root[:, None], one], 2), r, fold
        rows = torch.stack([self.pool.up(t) for t in self.T])  # T P, pixel by pixel
        return torch.cat([rows * g[:, None], one], 2), r, Whole()


def test_folding_changes_nothing():
    """Mode, solution and covariance of the small space's algebra against the large one's."""
    x = 0.3 * torch.randn(3, 129, generator=torch_rng(1))
    small, large = (approximate(Pooled(f), x, x, 0.5) for f in (True, False))
    assert torch.allclose(small.mode, large.mode, atol=1e-4)
    b = torch.randn(3, 129, generator=torch_rng(4))
    assert torch.allclose(small.solve(b), large.solve(b), atol=1e-4)
    assert torch.allclose(small.image(b), large.image(b), atol=1e-3)
    noise = torch_rng(5)
    draws = torch.stack([small.draw(noise)[0] for _ in range(2000)])
    exact = torch.stack([large.curvature[0].solve(e) for e in torch.eye(129)])
    assert_unit_covariance(whitened(draws, torch.zeros(129), exact))


def test_the_peak_is_found_from_afar():
    """From a light twenty times too dark, where a Newton step in log radiance overshoots, the same
    peak as from nearby.
    """
    likelihood, x = Pooled(True), torch.zeros(3, 129)
    likelihood.T = likelihood.T.abs()
    light = (0.3 * torch.randn(3, 128, generator=torch_rng(1))).exp()
    likelihood.y = 20 * torch.einsum("cnm,cm->cn", likelihood.T, likelihood.pool.down(light))
    target = lambda z: likelihood.value(z) - 0.5 * float((z - x).square().sum()) / 3.0**2
    near = approximate(likelihood, x, torch.cat([(20 * light).log(), torch.zeros(3, 1)], 1), 3.0)
    far = approximate(likelihood, x, x, 3.0)
    assert target(far.mode) > target(near.mode) - 20 and target(x) < target(near.mode) - 1e3


class Bright(LightLikelihood):
    """y = exp(z) + noise, one code per channel, known to 30 %: skewed in z, where the prior N(0, 1)
    has its say.
    """

    y = torch.tensor([[0.2], [1.0], [4.0]])

    def value(self, z):
        return -0.5 * float(((self.y - z.exp()) / (0.3 * self.y)).square().sum())

    def expansion(self, z):
        return (z.exp() / (0.3 * self.y))[:, :, None], self.residual(z), Whole()

    def residual(self, z):
        return (self.y - z.exp()) / (0.3 * self.y)


def test_a_perturbed_peak_is_a_draw_where_the_likelihood_is_quadratic():
    """Without any slice after it: mean and whole covariance of z | x in closed form."""
    noise, n, rho = torch_rng(0), 1500, 0.7
    J, y = torch.randn(8, 12, generator=noise), torch.randn(8, generator=noise)
    x = torch.randn(12, generator=noise)
    covariance = torch.linalg.inv((J.T @ J + torch.eye(12) / rho**2).double())
    mean = covariance @ (J.T @ y + x / rho**2).double()

    likelihood, about = Linear(J.expand(n, 8, 12), y.expand(n, 8)), x.expand(n, 12)
    both = Randomness(numpy_rng(0), noise)
    draws, _ = draw_light(both, likelihood, about, 0 * about, rho, 0)
    white = whitened(draws, mean, covariance)
    assert n * float(white.mean(0).square().sum()) < stats.chi2.ppf(0.9999, 12)
    assert_unit_covariance(white)


def test_fresh_draws_have_the_posteriors_mean_and_spread():
    """Where the likelihood is not quadratic, begun far from the peak every time, against sums over
    a grid: to .2 deviations.
    """
    likelihood, both, x = Bright(), randomness(0), torch.zeros(3, 1)
    draws = torch.stack(
        [draw_light(both, likelihood, x, x - 4, 1.0, SLICES)[0] for _ in range(600)]
    )[:, :, 0].numpy()
    grid = np.linspace(-6, 4, 4001)[None]
    weight = np.exp(-0.5 * ((1 - np.exp(grid) / likelihood.y.numpy()) / 0.3) ** 2 - 0.5 * grid**2)
    weight /= weight.sum(1, keepdims=True)
    mean = (weight * grid).sum(1)
    deviation = np.sqrt((weight * (grid - mean[:, None]) ** 2).sum(1))
    assert (np.abs(draws.mean(0) - mean) / deviation).max() < 0.2
    np.testing.assert_allclose(draws.std(0), deviation, rtol=0.2)


def test_fresh_draws_of_many_unknowns_do_not_stay_at_the_peak():
    """In 129 unknowns of which the data bind few, begun at the peak itself: the usual drop of log
    density is half their number.
    """
    likelihood, both, x = Pooled(True), randomness(0), torch.zeros(3, 129)
    peak = approximate(likelihood, x, x, 1.0).mode
    target = lambda z: likelihood.value(z) - 0.5 * float((z - x).square().sum())
    drops = [
        target(peak) - target(draw_light(both, likelihood, x, peak, 1.0, 2)[0]) for _ in range(20)
    ]
    assert 0.65 < np.mean(drops) / (0.5 * 3 * 129) < 1.25


def test_pooling_keeps_energy_and_has_its_adjoint():
    pool, noise = Pool(8, 4), torch_rng(0)
    v, u = torch.randn(3, 128, generator=noise), torch.randn(3, 32, generator=noise)
    assert torch.allclose((pool.down(v) * u).sum(), (v * pool.up(u)).sum(), atol=1e-4)
    assert torch.allclose(pool.down(pool.spread(u)), u, atol=1e-6)


def test_gaussian_posterior_in_closed_form(gaussian):
    """Mean and whole covariance of 250 independent draws against the exact posterior.

    Annealing in finite time leaves a bias of the mean: of .10 to .18 posterior deviations in eight
    such problems, held to .25.
    """
    noise = torch_rng(3)
    J = 1.5 * torch.block_diag(*torch.randn(3, 10, 32, generator=noise))
    truth = gaussian.sample(1, noise).reshape(-1)
    y = J @ truth + torch.randn(30, generator=noise)

    C = dense(gaussian).double() + 1e-6 * torch.eye(96)
    covariance = torch.linalg.inv(torch.linalg.inv(C) + (J.T @ J).double())
    prior_mean = gaussian.flat_mean.reshape(-1).double()
    mean = covariance @ (torch.linalg.solve(C, prior_mean) + (J.T @ y).double())

    likelihood = Linear(J.expand(250, 30, 96), y.expand(250, 30))
    draws = chains(gaussian, likelihood, widths(24, 10.0, 0.03, 4), 250, 1)
    white = whitened(draws, mean, covariance)
    assert float(white.mean(0).square().mean()) - 1 / len(draws) < 0.25**2
    assert_unit_covariance(white)


class TwoModes:
    """Every pixel the same value, near -1 or near +1 with equal odds, deviation .15: closed-form
    denoiser.
    """

    height, width, spread = 2, 4, 0.15

    def denoise(self, x, sigma, label=None):
        size, v = x[0].numel(), self.spread**2
        total = x.reshape(len(x), -1).sum(1)
        shrink = v / (sigma**2 + size * v)  # pixels share one value: mu + spread e
        odds = torch.sigmoid(2 * total / (sigma**2 + size * v))
        mean = [m + shrink * (total - size * m) for m in (-1.0, 1.0)]
        return (odds * mean[1] + (1 - odds) * mean[0])[:, None, None, None].expand_as(x).clone()


@pytest.mark.slow
def test_both_modes_with_their_weights():
    """A likelihood that prefers the upper mode 7 : 3 and says nothing else; weights within four
    binomial errors. Its expansion says nothing at all, so only the slices bring the weights about.
    """

    class Tilt(LightLikelihood):
        def value(self, z):
            return 0.5 * np.log(7 / 3) * float(z.mean())

        def residual(self, z):
            return torch.zeros(1, 1)

        def expansion(self, z):  # only the reference: any will do
            return torch.zeros(1, 1, z.shape[1]), torch.zeros(1, 1), Whole()

    draws = apart(TwoModes(), Tilt(), widths(12, 10.0, 0.1, 2), 300, 0).mean(1)
    assert abs(float((draws > 0).float().mean()) - 0.7) < 4 * (0.21 / 300) ** 0.5
    assert 0.1 < float(draws[draws > 0].std()) < 0.2


def test_a_draw_depends_on_its_seed_only(gaussian):
    likelihood = Linear(torch.ones(1, 3, 96), torch.zeros(1, 3))
    first = chains(gaussian, likelihood, widths(3, 1.0, 0.1, 0), 1, 5)
    chains(gaussian, likelihood, widths(3, 1.0, 0.1, 0), 1, 6)
    assert torch.equal(first, chains(gaussian, likelihood, widths(3, 1.0, 0.1, 0), 1, 5))
