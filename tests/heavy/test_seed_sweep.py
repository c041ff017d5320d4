"""Two sweeps of seeds draw from the same posterior: `pytest -m heavy`, some two minutes."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from pipeline.base.config import Sample
from pipeline.posterior.samplers import SAMPLERS
from pipeline.prior.load import load_prior
from pipeline.render.envmap import sh_coefficients
from tests.posterior.conftest import problem, start, toy  # noqa: F401  (fixtures)
from tests.seeds import seeded

pytestmark = [pytest.mark.heavy, pytest.mark.usefixtures("one_thread")]
DRAWS = 8
SMALL = Sample(
    steps=8,
    pixels=400,
    spp=2,
    texture=32,
    learning_rate=0.05,
    levels=4,
    stay=1,
    points=150,
    views=4,
    region_steps=20,
    start_points=25,
)


def figures(x) -> np.ndarray:
    """Numbers of one draw: SH coefficients of the log light, mean log of the materials."""
    light = sh_coefficients(np.log(x.light + 1e-6)).ravel()
    return np.append(
        light, [np.log(x.base_color + 0.01).mean(), np.log(x.roughness).mean(), x.metallic.mean()]
    )


def test_a_seed_sweep_moves_nothing_but_noise(problem, start):  # noqa: F811
    """Welch's t between the sweeps' means, for every number; their p-values over all numbers, by
    Bonferroni. No two draws are alike.
    """
    prior = load_prior("prior_small")
    draw = lambda seed: SAMPLERS["split_gibbs"](problem, prior, start[0], SMALL, seed)[0]
    sweep = lambda first: np.array([figures(draw(first + k)) for k in range(DRAWS)])
    a, b = sweep(seeded(0)), sweep(seeded(DRAWS))
    moves = a.std(0) > 1e-9  # a draw may leave metallic at 0 throughout
    p = stats.ttest_ind(a[:, moves], b[:, moves], equal_var=False).pvalue
    ratio = a[:, moves].var(0, ddof=1) / b[:, moves].var(0, ddof=1)
    print(
        f"least p {p.min():.3f} of {len(p)}, median {np.median(p):.2f}; "
        f"median ratio of variances {np.median(ratio):.2f}"
    )
    assert moves.sum() > 25 and p.min() > 0.001 / len(p)
    assert 0.3 < np.median(ratio) < 3.3
    assert len(np.unique(np.concatenate([a, b])[:, 0])) == 2 * DRAWS
