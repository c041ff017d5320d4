"""Write the averaged weights of a training run under weights/, as fp16 safetensors in parts.

python -m pipeline.prior.training.export --run RUN --out weights/prior_base.safetensors
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from pipeline.base.errors import InputError, run_stage
from pipeline.prior.locate import part_paths
from pipeline.prior.weight_files import load_parts, save_parts


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--run", type=Path, required=True, help="folder of pipeline.prior.training.train"
    )
    parser.add_argument("--out", type=Path, required=True, help="NAME.safetensors")
    args = parser.parse_args()
    if not part_paths(args.run / "average.safetensors"):
        raise InputError(
            "holds no trained weights (average*.safetensors)",
            args.run,
            "train first: python -m pipeline.prior.training.train",
        )

    tensors, facts = load_parts(args.run / "average.safetensors")
    files = save_parts({name: t.half() for name, t in tensors.items()}, facts, args.out)
    print(json.dumps(facts | {"files": [file.name for file in files]}))


if __name__ == "__main__":
    run_stage(main)
