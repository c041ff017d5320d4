"""Simulation-based calibration of `split_gibbs`' light block with the trained prior (Talts et al.
2018).

python -m benchmarks.calibration --simulations 200 --draws 7 --out calibration.json

Each simulation draws a light from the prior itself, observes it through cosine lobes of random
sharpness with 10 % relative noise, and draws the posterior; the light's scale is known, so
noise_gain applies (without it the mean radiance of the draws comes out too low: chi-square p below
1e-4). Were the sampler exact, the truth's rank among the draws would be uniform for every
statistic: SH coefficients of the luminance up to order 2, and log radiance of eight random pixels.
Reported: the share of ranks that fall inside the draws' range (nominal (draws - 1) / (draws + 1)),
with its binomial band, the mean rank (nominal 0.5) and the chi-square p-value of the rank
histogram.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
import torch
from scipy import stats

from pipeline.base.files import write_json
from pipeline.base.images import luminance
from pipeline.base.progress import progress
from pipeline.geometry.mesh_io import unit
from pipeline.posterior.split_gibbs.gaussian_approximation import LightLikelihood
from pipeline.posterior.split_gibbs.light_draw import SLICES, draw_light
from pipeline.posterior.split_gibbs.light_moves import noise_gain, prior_steps, widths
from pipeline.posterior.split_gibbs.pooling import Whole
from pipeline.posterior.split_gibbs.state import Randomness
from pipeline.prior.load import load_prior
from pipeline.prior.sampling import FIRST_SIGMA, first_noise, reverse_diffusion
from pipeline.render.envmap import directions, sh_coefficients, solid_angles

FIRST, LAST = 1.0, 0.01  # widths of the splitting: the split block alone, started wide
ROWS = 40
ERROR = 0.1
NAMES = [f"SH {k}" for k in range(9)] + [f"pixel {k}" for k in range(8)]


class Observed(LightLikelihood):
    """y = A L(z) + noise with standard deviation ERROR y, per channel (LightLikelihood)."""

    def __init__(self, prior, A: torch.Tensor, y: torch.Tensor):
        self.prior = prior
        self.A = A
        self.y = y
        self.deviation = ERROR * y
        self.gain = 1.0

    def light(self, z: torch.Tensor) -> torch.Tensor:
        return (
            self.prior.decode(z.reshape(1, 3, self.prior.height, self.prior.width)).reshape(3, -1)
            / self.gain
        )

    def value(self, z: torch.Tensor) -> float:
        return -0.5 * float((self.residual(z) ** 2).sum())

    def residual(self, z: torch.Tensor) -> torch.Tensor:
        return (self.y - self.light(z) @ self.A.T) / self.deviation

    def expansion(self, z: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, Whole]:
        L = self.light(z)
        J = self.A[None] * (self.prior.log_spread * L)[:, None, :] / self.deviation[:, :, None]
        return J, self.residual(z), Whole()


def lobes(prior, rng) -> torch.Tensor:
    """(ROWS, M) cosine lobes about random directions, exponents 1 to 300, each of unit integral."""
    d = directions(prior.height, prior.width).reshape(-1, 3)
    solid = solid_angles(prior.height, prior.width).reshape(-1)
    axes = unit(rng.normal(size=(ROWS, 3)))
    A = np.maximum(axes @ d.T, 0) ** (10 ** rng.uniform(0, 2.5, (ROWS, 1))) * solid
    return torch.from_numpy((A / A.sum(1, keepdims=True)).astype(np.float32))


def statistics(prior, code: torch.Tensor, pixels: np.ndarray) -> np.ndarray:
    """SH coefficients of a code's luminance, then log luminance of `pixels`; (17,)."""
    light = prior.decode(code.reshape(1, 3, prior.height, prior.width))[0]
    Y = luminance(light.numpy().transpose(1, 2, 0))
    sh = sh_coefficients(np.repeat(Y[..., None], 3, -1))[:, 0]
    return np.concatenate([sh, np.log(Y.reshape(-1)[pixels])])


def simulate(job: tuple) -> np.ndarray:
    """Rank of the truth among the draws for every statistic."""
    seed, draws, levels, name, start = job
    torch.set_num_threads(1)
    prior = load_prior(name)
    rng = np.random.default_rng(seed)
    noise = torch.Generator().manual_seed(seed)
    with torch.no_grad():
        gaussian = load_prior(start)
        fresh = lambda n: reverse_diffusion(
            prior, first_noise(prior, gaussian, n, noise), FIRST_SIGMA, 30, None, rng, noise
        )
        truth = fresh(1)
        A, pixels = lobes(prior, rng), rng.integers(prior.height * prior.width, size=8)
        observed = Observed(prior, A, torch.ones(3, ROWS))
        clean = observed.light(truth) @ A.T
        y = clean * (1 + ERROR * torch.randn(clean.shape, generator=noise)).clamp_min(0.2)
        observed = Observed(prior, A, y)
        observed.deviation = ERROR * clean  # the noise's own deviation is given
        x = z = fresh(draws)
        for rho in map(float, widths(levels, FIRST, LAST, 4)):
            observed.gain = noise_gain(prior.log_spread, rho)
            pairs = [(one.reshape(3, -1), other.reshape(3, -1)) for one, other in zip(x, z)]
            z = torch.stack(
                [
                    draw_light(Randomness(rng, noise), observed, *pair, rho, SLICES)[0]
                    for pair in pairs
                ]
            )
            x = reverse_diffusion(
                prior, z.reshape(x.shape), rho, prior_steps(rho), None, rng, noise
            )  # one network call for all
        table = np.array([statistics(prior, code, pixels) for code in x])
        return (table < statistics(prior, truth, pixels)).sum(0)


def summary(ranks: np.ndarray, draws: int) -> dict:
    """ranks (simulations, statistics)."""
    nominal, n = (draws - 1) / (draws + 1), len(ranks)
    out = {}
    for group, columns in (("SH", range(9)), ("pixels", range(9, 17)), ("all", range(17))):
        r = ranks[:, list(columns)]
        inside = ((r > 0) & (r < draws)).mean()
        counts = np.bincount(r.ravel(), minlength=draws + 1)
        out[group] = {
            "inside": float(inside),
            "nominal": nominal,
            "binomial_deviation": float(np.sqrt(nominal * (1 - nominal) / n)),
            "mean_rank": float(r.mean() / draws),
            "histogram": counts.tolist(),
        }
    out["p_values"] = {
        name: float(stats.chisquare(np.bincount(ranks[:, k], minlength=draws + 1)).pvalue)
        for k, name in enumerate(NAMES)
    }
    return out


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--simulations", type=int, default=200)
    parser.add_argument("--draws", type=int, default=7)
    parser.add_argument("--levels", type=int, default=16)
    parser.add_argument("--prior", default="prior_tiny")
    parser.add_argument(
        "--start", default="gaussian_tiny", help="Gaussian prior of the first noise"
    )
    parser.add_argument("--workers", type=int, default=os.cpu_count())
    parser.add_argument("--out", type=Path)
    args = parser.parse_args()
    jobs = [(k, args.draws, args.levels, args.prior, args.start) for k in range(args.simulations)]
    with ProcessPoolExecutor(args.workers) as pool:
        ranks = np.array(list(progress(pool.map(simulate, jobs), "simulations", len(jobs))))
    result = {
        "machine": f"{platform.machine()}, {os.cpu_count()} cores",
        "simulations": len(ranks),
        "draws": args.draws,
        "levels": args.levels,
    } | summary(ranks, args.draws)
    print(json.dumps(result, indent=1))
    if args.out:
        write_json(args.out, result)


if __name__ == "__main__":
    main()
