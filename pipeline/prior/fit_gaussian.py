"""Fit the Gaussian prior to the data of a training run.

python -m pipeline.prior.fit_gaussian --data RUN/data.npz --out weights/gaussian_small.safetensors
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
from safetensors.torch import save_file

from ..errors import run_stage
from ..files import atomic_path
from .gaussian import spectra

REAL_SHARE = 0.6        # weight of real maps against procedural ones, as in the diffusion prior's training


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True, help="data.npz of a training run (pipeline.prior.train)")
    parser.add_argument("--out", type=Path, required=True)
    args = parser.parse_args()
    data = np.load(args.data)
    real, made = data["real"][~data["held"]], data["made"]
    codes = (np.concatenate([real, made]).astype(np.float32) - data["mean"]) / (2 * data["std"])
    weights = np.concatenate([np.full(len(real), REAL_SHARE / len(real)), np.full(len(made), (1 - REAL_SHARE) / len(made))])
    mean, covariance = spectra(codes, weights)
    facts = {"format": "gaussian", "mean": float(data["mean"]), "std": float(data["std"]), "height": codes.shape[2],
             "real_maps": len(real), "procedural_maps": len(made)}
    with atomic_path(args.out) as temporary:
        save_file({"mean": mean, "covariance": covariance.contiguous()}, str(temporary), {"heliograph": json.dumps(facts)})
    print(json.dumps(facts))


if __name__ == "__main__":
    run_stage(main)
