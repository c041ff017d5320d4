"""Reverse diffusion: from a code seen through noise, or from noise alone, to a draw of the prior.

python -m pipeline.prior.sampling --prior prior_base --count 64 --label outdoor --out sheet.png
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import torch

from pipeline.base.errors import run_stage
from pipeline.base.images import in_rows, to_srgb8, write_png
from pipeline.base.progress import Bar
from pipeline.prior.gaussian import GaussianPrior, translated
from pipeline.prior.load import load_gaussian, load_prior
from pipeline.prior.protocol import DenoisingPrior, Prior

# noise level that a draw starts from: the largest modes of natural light, of twice that deviation,
# still show through, and a Gaussian prior gives them
FIRST_SIGMA = 20.0
# The next five were chosen on 48 draws of another seed than those that benchmarks/prior.py judges.
GUIDANCE = 2.5  # how far beyond the unlabelled mean
GUIDED_FROM = 0.2  # noise levels between which there is guidance
GUIDED_TO = 6.0
CHURN = 0.5
EXCESS = 1.02


def reverse_diffusion(
    prior: DenoisingPrior,
    z: torch.Tensor,
    rho: float,
    steps: int,
    label: str | Sequence[str | None] | None,
    rng: np.random.Generator,
    noise: torch.Generator,
    end: float = 0.01,
    done: Callable[[], None] | None = None,
    churn: float = 1.0,
    excess: float = 1.0,
) -> torch.Tensor:
    """A draw of x given z = x + rho n: from noise level rho to none; codes (n, 3, h, w).

    SDE-DPM-Solver++(2M) of Lu et al. (2022) in EDM's variance-exploding form, `steps` calls of the
    network, each under a random roll of the columns (DPI, Eq. 19). From noise level t to s, with
    D(x; t) = prior.denoise and step = log(t / s):

        ahead = D + step / (2 step before) (D - D before)
        keep = (s / t)^(1 + churn^2)
        x <- keep x + (1 - keep) ahead + excess s sqrt(1 - (s / t)^(2 churn^2)) n

    churn 0 is the noise-free ODE, 1 the SDE; `excess` multiplies the fresh noise (S_noise of Karras
    et al. 2022). `end` is the last noise level before 0. `rng` rolls, `noise` gives n. `done` is
    called after every step.
    """
    levels = np.append(np.geomspace(rho, min(end, 0.3 * rho), steps), 0.0)
    x = z
    clean_before = None
    step_before = 0.0

    for t, s in zip(levels[:-1], levels[1:]):
        columns = int(rng.integers(x.shape[-1]))
        clean = prior.denoise(x.roll(columns, -1), float(t), label).roll(-columns, -1)
        if done:
            done()
        if s == 0:
            return clean

        step = np.log(t / s)
        ahead = clean
        if clean_before is not None:
            ahead = clean + 0.5 * step / step_before * (clean - clean_before)

        keep = (s / t) ** (1 + churn**2)
        fresh = excess * s * np.sqrt(1 - (s / t) ** (2 * churn**2))
        x = keep * x + (1 - keep) * ahead + fresh * torch.randn(x.shape, generator=noise)

        clean_before = clean
        step_before = step
    return x


class Guided:
    """A prior whose network's mean is led away from the unlabelled one: classifier-free guidance
    (Ho and Salimans 2022) at middle noise levels only (Kynkäänniemi et al. 2024). It gives back the
    contrast that a small network's samples lack; for draws of the prior alone, not for posteriors,
    which it would make too sure.
    """

    def __init__(self, prior: DenoisingPrior):
        self.prior = prior

    def denoise(
        self, x: torch.Tensor, sigma: float, label: str | Sequence[str | None] | None = None
    ) -> torch.Tensor:
        labelled = self.prior.denoise(x, sigma, label)
        if not GUIDED_FROM < sigma < GUIDED_TO:
            return labelled
        plain = self.prior.denoise(x, sigma, None)
        return plain + GUIDANCE * (labelled - plain)


def classes(shares: dict[str, float], count: int, rng: np.random.Generator) -> list[str]:
    """`count` classes as near to their shares as whole numbers get, in random order."""
    exact = count * np.array(list(shares.values()))
    numbers = np.floor(exact).astype(int)
    numbers[np.argsort(numbers - exact, kind="stable")[: count - numbers.sum()]] += 1
    return [str(name) for name in rng.permutation(np.repeat(list(shares), numbers))]


def first_noise(
    prior: Prior, gaussian: GaussianPrior, count: int, noise: torch.Generator
) -> torch.Tensor:
    """Codes (count, 3, h, w) seen through noise of FIRST_SIGMA, where a Gaussian describes them
    well enough.

    White noise alone would have to be of deviation 200 to drown the largest modes, a level that
    training hardly visits.
    """
    code = translated(gaussian.sample(count, noise), gaussian, prior)
    return code + FIRST_SIGMA * torch.randn(code.shape, generator=noise)


def draw(
    prior: Prior,
    count: int,
    steps: int,
    seed: int,
    label: str | None = None,
    batch: int = 16,
    start: str = "gaussian_small",
) -> torch.Tensor:
    """`count` codes (count, 3, h, w) of the prior alone, deterministic in `seed` and `count`.
    Without `label` the classes come in the shares they have among the maps trained on, where those
    had classes. `start`: name of the Gaussian prior of the first noise.
    """
    noise = torch.Generator().manual_seed(seed)
    rng = np.random.default_rng(seed)
    gaussian = load_gaussian(start)
    labels: list[str | None] = [label] * count
    if prior.shares and not label:
        labels = [*classes(prior.shares, count, rng)]
    guided = prior if None in labels else Guided(prior)

    out = []
    with torch.no_grad(), Bar("prior samples", steps * -(-count // batch)) as bar:
        drawn = partial(reverse_diffusion, churn=CHURN, excess=EXCESS, done=bar.step)
        for first in range(0, count, batch):
            part = labels[first : first + batch]
            z = first_noise(prior, gaussian, len(part), noise)
            out.append(drawn(guided, z, FIRST_SIGMA, steps, part, rng, noise))
    return torch.cat(out)


def lights(prior: Prior, codes: torch.Tensor) -> np.ndarray:
    """Scale-free radiance (n, h, w, 3)."""
    return prior.decode(codes).numpy().transpose(0, 2, 3, 1)


def sheet(maps: np.ndarray, columns: int = 8, width: int = 192) -> np.ndarray:
    """Tone-mapped contact sheet (h, w, 3) uint8 of lights (n, h, w, 3)."""
    size = (width, width // 2)
    tiles = [cv2.resize(to_srgb8(m * 0.35), size, interpolation=cv2.INTER_NEAREST) for m in maps]
    return in_rows(tiles, columns)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--prior", default="prior_base")
    parser.add_argument("--count", type=int, default=64)
    parser.add_argument("--steps", type=int, default=40)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--label", help="indoor, outdoor, studio or night; none: as often as in the data"
    )
    parser.add_argument("--out", type=Path, required=True)
    args = parser.parse_args()

    prior = load_prior(args.prior)
    codes = draw(prior, args.count, args.steps, args.seed, args.label)
    write_png(args.out, sheet(lights(prior, codes)))


if __name__ == "__main__":
    run_stage(main)
