"""Priors over natural light behind one protocol. PRIORS: format name -> loader(tensors, facts).

A prior has `.height`, `.width`, `.denoise(x, sigma, label)` (torch, (n, 3, h, w) codes -> estimate
of the clean code, differentiable), `.decode(x)` (codes -> scale-free radiance (n, 3, h, w)),
`.encode(radiance (h, w, 3))`, and `.log_spread`, the change of log radiance per unit of code.
"""

from __future__ import annotations

from pipeline.base.errors import InputError
from pipeline.prior.diffusion import DiffusionPrior
from pipeline.prior.gaussian import GaussianPrior
from pipeline.prior.locate import find_prior
from pipeline.prior.weight_files import load_parts

PRIORS = {"diffusion": DiffusionPrior.from_tensors, "gaussian": GaussianPrior.from_tensors}


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
            "give a file written by `python -m pipeline.prior.training.export` or pipeline.prior.training.fit_gaussian",
        ) from error
