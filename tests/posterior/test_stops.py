"""Samplers that may be stopped early, for anytime curves (benchmarks/anytime)."""

import numpy as np
import pytest

from benchmarks.anytime.stops import RUNS
from pipeline.base.config import Sample
from pipeline.posterior.samplers import SAMPLERS
from pipeline.prior.load import load_prior
from tests.seeds import seeded


@pytest.mark.parametrize("name", sorted(RUNS))
def test_the_last_stop_is_the_whole_run(name, problem, start):
    """Also after other stops were looked at: they take no random number of the run."""
    small = {"points": 60, "start_points": 40, "smooth": 1, "levels": 2, "light": 16}
    settings = Sample(method=name, steps=3, texture=32, pixels=256, **small)
    prior = load_prior("prior_small")
    given = (problem, prior, start[0], settings, seeded(0))
    run = RUNS[name](*given)
    ends = [stop() for stop in run.stops]
    whole, _ = SAMPLERS[name](*given)

    assert len(ends) == run.count
    for part in ("light", "base_color", "roughness", "metallic"):
        np.testing.assert_array_equal(getattr(ends[-1], part), getattr(whole, part))
    assert not np.array_equal(ends[0].light, whole.light)
