"""Unconditional samples of a prior: DDPM's ancestral sampler with the random yaw roll of DPI's Eq. 19.

python -m pipeline.prior.sampling --prior prior_small --count 16 --out sheet.png
"""

from __future__ import annotations

import argparse
from pathlib import Path

import cv2
import numpy as np
import torch

from ..errors import run_stage
from ..images import to_srgb8, write_png
from ..progress import progress
from . import load_prior
from .schedule import ALPHA_BAR, posterior, sigma, subsequence


def draw(prior, count: int, steps: int, seed: int, label: str | None = None) -> np.ndarray:
    """`count` scale-free lights (n, h, w, 3), deterministic in `seed`."""
    noise, rng = torch.Generator().manual_seed(seed), np.random.default_rng(seed)
    x = torch.randn((count, 3, prior.height, prior.width), generator=noise)
    levels = subsequence(steps)
    with torch.no_grad():
        for t, s in zip(progress(levels, "prior samples"), list(levels[1:]) + [-1]):
            roll = int(rng.integers(prior.width))
            x = x.roll(roll, -1)
            x0 = prior.denoise(x / np.sqrt(ALPHA_BAR[t]), sigma(t), label)
            a, b, deviation = posterior(int(t), int(s))
            x = (a * x0 + b * x + deviation * torch.randn(x.shape, generator=noise)).roll(-roll, -1)
        return prior.decode(x).numpy().transpose(0, 2, 3, 1)


def sheet(lights: np.ndarray, columns: int = 4, width: int = 192) -> np.ndarray:
    """Tone-mapped contact sheet (h, w, 3) uint8."""
    tiles = [cv2.resize(to_srgb8(light * 0.35), (width, width // 2), interpolation=cv2.INTER_NEAREST) for light in lights]
    return np.concatenate([np.concatenate(tiles[k:k + columns], 1) for k in range(0, len(tiles), columns)])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--prior", default="prior_small")
    parser.add_argument("--count", type=int, default=16)
    parser.add_argument("--steps", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--label")
    parser.add_argument("--out", type=Path, required=True)
    args = parser.parse_args()
    write_png(args.out, sheet(draw(load_prior(args.prior), args.count, args.steps, args.seed, args.label)))


if __name__ == "__main__":
    run_stage(main)
