"""Priors over natural light behind one protocol. PRIORS: format name -> loader(path).

A prior has `.height`, `.width`, `.denoise(x, sigma, label)` (torch, (n, 3, h, w) codes -> estimate of the clean code,
differentiable), `.decode(x)` (codes -> scale-free radiance (n, 3, h, w)), `.encode(radiance (h, w, 3))`.
"""

from __future__ import annotations

from pathlib import Path

from ..errors import InputError, nearest
from .diffusion import DiffusionPrior

PRIORS = {"diffusion": DiffusionPrior.load}
WEIGHTS = Path(__file__).resolve().parent.parent.parent / "weights"


def find_prior(name: str) -> Path:
    """The weight file of a name under weights/, or the path itself."""
    path = Path(name) if name.endswith(".safetensors") else WEIGHTS / f"{name}.safetensors"
    if not path.exists():
        raise InputError("there is no such prior", path, nearest(name, [p.stem for p in WEIGHTS.glob("*.safetensors")] or ["none"]))
    return path


def load_prior(name: str):
    """Load the prior called `name` (see `find_prior`)."""
    return PRIORS["diffusion"](find_prior(name))
