"""Priors over natural light behind one protocol. PRIORS: format name -> loader(tensors, facts).

A prior has `.height`, `.width`, `.denoise(x, sigma, label)` (torch, (n, 3, h, w) codes -> estimate
of the clean code, differentiable), `.decode(x)` (codes -> scale-free radiance (n, 3, h, w)),
`.encode(radiance (h, w, 3))`, and `.log_spread`, the change of log radiance per unit of code.
"""

from __future__ import annotations

from pathlib import Path

from pipeline.base.errors import InputError, nearest
from pipeline.prior.diffusion import DiffusionPrior
from pipeline.prior.gaussian import GaussianPrior
from pipeline.prior.weight_files import CURE, load_parts, part_paths

PRIORS = {"diffusion": DiffusionPrior.from_tensors, "gaussian": GaussianPrior.from_tensors}
WEIGHTS = Path(__file__).resolve().parents[2] / "weights"


def known_priors() -> list[str]:
    """Names of the priors under weights/."""
    return sorted({p.stem.split("-")[0] for p in WEIGHTS.glob("*.safetensors")})


def find_prior(name: str) -> Path:
    """NAME.safetensors of a name under weights/, or the path itself; the file may be split into
    parts (`weight_files`). Raises InputError where there is no such file.
    """
    path = Path(name) if name.endswith(".safetensors") else WEIGHTS / f"{name}.safetensors"
    if not part_paths(path):
        raise InputError("there is no such prior", path, nearest(name, known_priors() or ["none"]))
    return path


def load_prior(name: str):
    """Load the prior called `name` (see `find_prior`); the file's metadata names its format."""
    path = find_prior(name)
    tensors, facts = load_parts(path)
    try:
        return PRIORS[facts.get("format", "diffusion")](tensors, facts)
    except (KeyError, RuntimeError, TypeError) as error:
        raise InputError(
            f"not a Heliograph light prior ({type(error).__name__}: {error})",
            path,
            CURE,
        ) from error
