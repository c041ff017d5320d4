"""Fit the Gaussian prior to the data of a training run.

python -m pipeline.prior.training.fit_gaussian --data RUN/data.npz \\
    --out weights/gaussian_small.safetensors
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

from pipeline.base.errors import run_stage
from pipeline.prior.gaussian import spectra
from pipeline.prior.training.data import Data
from pipeline.prior.weight_files import save_parts

REAL_SHARE = 0.6  # weight of measured maps against made ones, as in the diffusion prior's training


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--data",
        type=Path,
        required=True,
        help="data.npz of a training run (pipeline.prior.training.train)",
    )
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--height", type=int, default=32)
    args = parser.parse_args()

    data = Data.load(args.data, args.height)
    logs = data.logs(~data.held)
    made = data.made[~data.held]
    weights = np.where(made, (1 - REAL_SHARE) / max(made.sum(), 1), REAL_SHARE / (~made).sum())
    mean, covariance = spectra(data.codes(logs), weights)

    facts = {
        "format": "gaussian",
        "mean": data.mean,
        "std": data.std,
        "height": args.height,
        "real_maps": int((~made).sum()),
        "made_maps": int(made.sum()),
    }
    files = save_parts({"mean": mean, "covariance": covariance}, facts, args.out)
    print(json.dumps(facts | {"files": [file.name for file in files]}))


if __name__ == "__main__":
    run_stage(main)
