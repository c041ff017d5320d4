"""A likelihood of rows on the ball: two regions, one glossy dielectric and one metal."""

from dataclasses import replace

import numpy as np
import pytest

from pipeline.posterior.split_gibbs.likelihood import Mixer, RowLikelihood
from pipeline.posterior.split_gibbs.lobes import LobeTable
from pipeline.posterior.split_gibbs.row_model import RowData
from pipeline.posterior.split_gibbs.state import Noise, RegionMaterials
from tests.render.test_transport import bowl, scene, transport  # noqa: F401  (fixtures)
from tests.seeds import numpy_rng

POINTS = 40


def with_data(rows: RowLikelihood, **changes) -> RowLikelihood:
    """The same likelihood of other data; the lobes stay."""
    return replace(rows, data=replace(rows.data, **changes))


@pytest.fixture(scope="module")
def rows(transport) -> RowLikelihood:  # noqa: F811
    rng = numpy_rng(2)
    n = len(transport.rows.point)
    observed = rng.uniform(0.1, 1.0, (n, 3))
    region = rng.integers(0, 2, POINTS)
    weight = rng.uniform(0.5, 2, n)
    data = replace(
        RowData.plain(transport, LobeTable.trace(transport, 0.2, 0), observed, region, 1),
        point_weight=rng.uniform(0.3, 2, POINTS),
    )
    materials = RegionMaterials(
        color=rng.uniform(0.2, 0.6, (2, 3)),
        spread=np.array([0.1, 0.5]),
        roughness=np.array([6, 16]),
        metallic=np.array([0.0, 0.8]),
    )
    noise = Noise(scale=0.2, weight=weight, design_effect=1.7)
    return RowLikelihood.at(Mixer(data), noise, materials, np.zeros((3, POINTS), int))


@pytest.fixture
def light(scene) -> np.ndarray:  # noqa: F811
    """The scene's light as the operator takes it, (M, 3)."""
    return scene[2].reshape(-1, 3).astype(float)
