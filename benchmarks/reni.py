"""A RENI-like prior as a yardstick: a yaw-equivariant conditional neural field, trained as a
variational auto-decoder.

python -m benchmarks.reni --data RUN/data.npz --height 64 --minutes 10 --out reni.npz

The field (pipeline/prior/equivariant.py) is trained by pipeline/prior/training/auto_decoder.py;
samples decode draws of N(0, I). Writes `codes`.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import torch

from pipeline.base.errors import run_stage
from pipeline.base.files import atomic_path
from pipeline.prior.equivariant import EquivariantField
from pipeline.prior.training.auto_decoder import fit
from pipeline.prior.training.data import Data
from pipeline.prior.value_code import Code


def elapsed(minutes: float) -> Iterator[float]:
    """The share of `minutes` that is over, until they are."""
    start = time.monotonic()
    while (spent := (time.monotonic() - start) / 60) < minutes:
        yield spent / minutes


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--height", type=int, default=64)
    parser.add_argument("--minutes", type=float, default=10)
    parser.add_argument("--count", type=int, default=128)
    parser.add_argument("--out", type=Path, required=True)
    args = parser.parse_args()
    torch.set_num_threads(1)
    data = Data.load(args.data, args.height)
    torch.manual_seed(0)
    field = EquivariantField(Code(data.mean, data.std))
    fit(field, data.measured(False), elapsed(args.minutes))
    with torch.no_grad():
        draws = torch.randn(args.count, 1, *field.latents)
        codes = torch.cat([field.codes(z, args.height) for z in draws])
    with atomic_path(args.out) as temporary, open(temporary, "wb") as file:
        np.savez(file, codes=codes.numpy())


if __name__ == "__main__":
    run_stage(main)
