"""What settings of a sampler and its priors must have in common, found out before the first job.
Without torch, so that the Snakefile may ask at no cost.
"""

from __future__ import annotations

from pipeline.base.config import Sample
from pipeline.base.errors import InputError, nearest
from pipeline.prior.locate import find_prior, generator_files
from pipeline.prior.weight_facts import generator_rows, prior_facts

BY_OPERATOR = ("split_gibbs", "gaussian")  # samplers that pool the light's rows


def check_settings(settings: Sample) -> None:
    """Raises InputError for a prior that is not there, a class that it does not know, a Gaussian
    prior that is none, rows of the light that do not divide the priors' rows, and a prior whose
    rows the sampler's generator cannot make.
    """
    prior = prior_facts(settings.prior)
    if prior.labels and settings.label is not None and settings.label not in prior.labels:
        raise InputError(
            f"the prior has no class '{settings.label}'",
            "sample.label",
            nearest(settings.label, prior.labels),
        )
    if settings.method in BY_OPERATOR:
        start = prior_facts(settings.start_prior)
        if start.format != "gaussian":
            raise InputError(
                "this prior is a network, a Gaussian prior is asked for",
                find_prior(settings.start_prior),
                "name one like gaussian_small in sample.start_prior",
            )
        _divides("sample.start_prior", start.height, prior.height)
        _divides("sample.light", settings.light, prior.height)
        _divides("sample.light", settings.light, start.height)
    if generator_files(settings.method):
        rows = generator_rows(settings.method)
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
