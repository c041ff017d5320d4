"""Write the averaged weights of a training run as fp16 safetensors.

python -m pipeline.prior.export --run RUN --config configs/prior_small.yaml --out weights/prior_small.safetensors
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
import torch
from safetensors.torch import save_file

from ..config import read_yaml
from ..errors import run_stage
from ..files import atomic_path


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--run", type=Path, required=True)
    parser.add_argument("--config", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    args = parser.parse_args()
    config = read_yaml(args.config)
    state = torch.load(args.run / "checkpoint.pt", map_location="cpu", weights_only=True)
    data = np.load(args.run / "data.npz")
    facts = {"network": config["network"], "height": config["height"], "mean": float(data["mean"]), "std": float(data["std"]),
             "images": state["images"], "real_maps": int((~data["held"]).sum()), "held_out_maps": int(data["held"].sum()),
             "procedural_maps": len(data["made"])}
    with atomic_path(args.out) as temporary:
        save_file({k: v.half().contiguous() for k, v in state["average"].items()}, str(temporary), {"heliograph": json.dumps(facts)})
    print(json.dumps(facts))


if __name__ == "__main__":
    run_stage(main)
