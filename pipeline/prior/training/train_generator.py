"""Train a generator of lights, which a sampler of earlier work inverts, on procedural lights.

python -m pipeline.prior.training.train_generator --kind gan_latent --cache RUN/made_lights.npz \\
    --out weights/generators/gan_latent.safetensors

On one thread, of the same bits every time on a machine. The lights are made from `--seed` and kept
in `--cache`, so that both kinds see the same ones.
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
from pipeline.prior.training.made_lights import MadeLights, make_lights, views_of
from pipeline.prior.weight_files import save_parts

HEIGHT = 32
VIEWS = 4  # of each light
FIELD = {"count": 25, "hidden": 128, "layers": 4}


def gan_latent(stored: np.ndarray, steps: int, seed: int) -> tuple[torch.nn.Module, dict]:
    """An adversarial generator, and the facts that it is loaded by."""
    lights: MadeLights = views_of(stored, HEIGHT, VIEWS, seed)
    torch.manual_seed(seed)
    made = train(AdversarialGenerator(lights.code), lights, steps, seed)
    code = {"mean": lights.code.mean, "std": lights.code.std}
    return made, {"format": "adversarial", **code, "channels": made.channels}


def equivariant_field(stored: np.ndarray, steps: int, seed: int) -> tuple[torch.nn.Module, dict]:
    """A field, and the facts that it is loaded by. One view of each light: the others are turns,
    which its latents take up.
    """
    lights = views_of(stored, HEIGHT, 1, seed)
    torch.manual_seed(seed)
    field = EquivariantField(lights.code, **FIELD)
    fit(field, lights.codes.numpy(), progress(np.arange(steps) / steps, "auto-decoder"), seed)
    code = {"mean": lights.code.mean, "std": lights.code.std}
    return field, {"format": "equivariant", **code, "shape": field.shape}


KINDS = {"gan_latent": (gan_latent, 3000), "equivariant_field": (equivariant_field, 5000)}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--kind", choices=list(KINDS), required=True)
    parser.add_argument("--lights", type=int, default=400)
    parser.add_argument("--steps", type=int, help="of training; none: the kind's own number")
    parser.add_argument("--seed", type=int, default=11)
    parser.add_argument("--cache", type=Path, required=True, help="lights, made where missing")
    parser.add_argument("--out", type=Path, required=True)
    args = parser.parse_args()

    set_threads(1)
    stored = make_lights(args.lights, HEIGHT, args.seed, args.cache)
    begin, (make, standard) = time.process_time(), KINDS[args.kind]
    steps = args.steps or standard
    made, facts = make(stored, steps, args.seed)
    trained = {"steps": steps, "lights": len(stored), "seed": args.seed}
    tensors = {name: value.detach().half() for name, value in made.state_dict().items()}
    files = save_parts(tensors, facts | trained, args.out)
    spent = {"core_seconds": round(time.process_time() - begin), "files": [f.name for f in files]}
    print(json.dumps(facts | trained | spent))


if __name__ == "__main__":
    run_stage(main)
