"""Priors over natural light behind one protocol. PRIORS: format name -> loader(open safetensors file, facts).

A prior has `.height`, `.width`, `.denoise(x, sigma, label)` (torch, (n, 3, h, w) codes -> estimate of the clean code,
differentiable), `.decode(x)` (codes -> scale-free radiance (n, 3, h, w)), `.encode(radiance (h, w, 3))`, and `.log_spread`, the change
of log radiance per unit of code.
"""

from __future__ import annotations

import json
from pathlib import Path

from ..errors import InputError, nearest
from .diffusion import DiffusionPrior
from .gaussian import GaussianPrior

PRIORS = {"diffusion": DiffusionPrior.from_file, "gaussian": GaussianPrior.from_file}
WEIGHTS = Path(__file__).resolve().parent.parent.parent / "weights"


def find_prior(name: str) -> Path:
    """The weight file of a name under weights/, or the path itself."""
    path = Path(name) if name.endswith(".safetensors") else WEIGHTS / f"{name}.safetensors"
    if not path.exists():
        raise InputError("there is no such prior", path, nearest(name, [p.stem for p in WEIGHTS.glob("*.safetensors")] or ["none"]))
    return path


def load_prior(name: str):
    """Load the prior called `name` (see `find_prior`): a .safetensors file whose metadata names its format."""
    from safetensors import SafetensorError, safe_open
    path = find_prior(name)
    try:
        with safe_open(str(path), "pt") as file:
            facts = json.loads((file.metadata() or {})["heliograph"])
            return PRIORS[facts.get("format", "diffusion")](file, facts)
    except (SafetensorError, KeyError, RuntimeError, OSError, TypeError) as error:
        raise InputError(f"not a Heliograph light prior ({type(error).__name__}: {error})", path,
                         "give a file written by `python -m pipeline.prior.export` or pipeline.prior.fit_gaussian") from error
