"""Train a generator of lights, which a sampler of earlier work inverts, on the maps that the
diffusion priors have learnt from.

python -m pipeline.prior.training.train_generator --kind gan_latent --data RUN/data.npz \\
    --out weights/generators/gan_latent.safetensors

RUN/data.npz is the cache of maps that pipeline.prior.training.train makes. Both kinds see the same
views of them. On a processor one thread works, with the same bits every time on a machine.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import numpy as np
import torch

from pipeline.base.errors import run_stage
from pipeline.base.progress import progress
from pipeline.base.runtime import set_threads
from pipeline.prior.adversarial import AdversarialGenerator
from pipeline.prior.equivariant import EquivariantField
from pipeline.prior.training.adversarial_training import train
from pipeline.prior.training.auto_decoder import fit
from pipeline.prior.training.data import Data
from pipeline.prior.training.lights import Lights, views_of
from pipeline.prior.training.settings import Training
from pipeline.prior.weight_files import save_parts

HEIGHT = 32
REAL_SHARE = Training().real_share  # of the views, as in the diffusion priors' batches
FIELD = {"count": 36, "hidden": 192, "layers": 5}


def gan_latent(lights: Lights, steps: int, seed: int) -> tuple[torch.nn.Module, dict]:
    """An adversarial generator, and the facts that it is loaded by."""
    torch.manual_seed(seed)
    generator = AdversarialGenerator(lights.code).to(lights.codes.device)
    made = train(generator, lights, steps, seed)
    code = {"mean": lights.code.mean, "std": lights.code.std}
    return made, {"format": "adversarial", **code, "channels": made.channels}


def equivariant_field(lights: Lights, steps: int, seed: int) -> tuple[torch.nn.Module, dict]:
    """A field, and the facts that it is loaded by."""
    torch.manual_seed(seed)
    field = EquivariantField(lights.code, **FIELD).to(lights.codes.device)
    fit(field, lights.codes, progress(np.arange(steps) / steps, "auto-decoder"), seed)
    code = {"mean": lights.code.mean, "std": lights.code.std}
    return field, {"format": "equivariant", **code, "shape": field.shape}


KINDS = {"gan_latent": gan_latent, "equivariant_field": equivariant_field}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--kind", choices=list(KINDS), required=True)
    parser.add_argument("--data", type=Path, required=True, help="cache of training maps")
    parser.add_argument("--views", type=int, default=2000)
    parser.add_argument("--steps", type=int, default=20_000, help="of training")
    parser.add_argument("--seed", type=int, default=11)
    parser.add_argument("--device", default="cpu", help="torch's name: cpu or cuda")
    parser.add_argument("--out", type=Path, required=True)
    args = parser.parse_args()

    set_threads(1)
    lights = views_of(Data.load(args.data, HEIGHT), args.views, REAL_SHARE, args.seed)
    begin = time.monotonic()
    made, facts = KINDS[args.kind](lights.on(args.device), args.steps, args.seed)
    trained = {"steps": args.steps, "views": args.views, "seed": args.seed}
    tensors = {name: value.detach().cpu().half() for name, value in made.state_dict().items()}
    files = save_parts(tensors, facts | trained, args.out)
    spent = {"seconds": round(time.monotonic() - begin), "files": [f.name for f in files]}
    print(json.dumps(facts | trained | spent))


if __name__ == "__main__":
    run_stage(main)
