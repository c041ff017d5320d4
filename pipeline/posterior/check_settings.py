"""What settings of a sampler and its priors must have in common, found out before anything large is
read.
"""

from __future__ import annotations

from pipeline.base.config import Sample
from pipeline.base.errors import InputError, nearest
from pipeline.posterior.samplers import SAMPLERS
from pipeline.prior.diffusion import DiffusionPrior
from pipeline.prior.generators import load_generator
from pipeline.prior.load import load_gaussian
from pipeline.prior.locate import generator_files
from pipeline.prior.protocol import Prior

BY_OPERATOR = ("split_gibbs", "gaussian")  # samplers that pool the light's rows


def check_settings(settings: Sample, prior: Prior) -> None:
    """Raises InputError for an unknown sampler, a class that the prior does not know, a search
    prior that is none, rows of the light that do not divide the priors' rows, and a prior whose
    rows the sampler's generator cannot make.
    """
    if settings.method not in SAMPLERS:
        raise InputError(
            f"unknown sampler '{settings.method}'",
            "sample.method",
            nearest(settings.method, SAMPLERS),
        )
    if isinstance(prior, DiffusionPrior):
        prior.label_index(settings.label)
    if settings.method in BY_OPERATOR:
        search = load_gaussian(settings.search_prior)
        _divides("sample.search_prior", search.height, prior.height)
        _divides("sample.light", settings.light, prior.height)
        _divides("sample.light", settings.light, search.height)
    if generator_files(settings.method):
        rows = load_generator(settings.method).rows
        if prior.height % rows:
            raise InputError(
                f"{settings.method} makes lights of a multiple of {rows} rows, not of the prior's "
                f"{prior.height}",
                "sample.prior",
                "choose prior_small or prior_base",
            )


def _divides(key: str, rows: int, of: int) -> None:
    if of % rows:
        raise InputError(
            f"a light of {rows} rows does not divide the prior's {of}",
            key,
            f"choose a divisor of {of} for sample.light, or another prior",
        )
