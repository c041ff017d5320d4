"""Priors over natural light, all of the form `Prior` (prior/protocol.py).

PRIORS: format name in the weights' metadata -> loader(tensors, facts).
"""

from __future__ import annotations

from collections.abc import Callable

from pipeline.base.errors import InputError
from pipeline.prior.diffusion import DiffusionPrior
from pipeline.prior.gaussian import GaussianPrior
from pipeline.prior.locate import find_prior
from pipeline.prior.protocol import Prior
from pipeline.prior.weight_facts import CURE
from pipeline.prior.weight_files import load_parts

PRIORS: dict[str, Callable[[dict, dict], Prior]] = {
    "diffusion": DiffusionPrior.from_tensors,
    "gaussian": GaussianPrior.from_tensors,
}


def load_prior(name: str) -> Prior:
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


def load_gaussian(name: str) -> GaussianPrior:
    """As `load_prior`, for a Gaussian prior. Raises InputError where it is another one."""
    prior = load_prior(name)
    if not isinstance(prior, GaussianPrior):
        raise InputError(
            "this prior is a network, a Gaussian prior is asked for",
            find_prior(name),
            "name one like gaussian_small, or fit one: pipeline.prior.training.fit_gaussian",
        )
    return prior
