"""Lobes at every roughness: against the path tracer, the traced lobes, and the metals there are."""

import numpy as np
import pytest

from pipeline.posterior.split_gibbs.coherence import OTHER
from pipeline.posterior.split_gibbs.likelihood import Mixer, RowLikelihood, point_materials
from pipeline.posterior.split_gibbs.lobes import BETWEEN, TRACED, LobeTable
from pipeline.posterior.split_gibbs.row_model import RowData
from pipeline.posterior.split_gibbs.state import Noise, RegionMaterials
from pipeline.render.rows import choose_rows
from pipeline.render.transport import Transport
from tests.render.test_transport import traced, uniform
from tests.seeds import numpy_rng, seeded


def one_material(color: float, roughness: int, metallic: float) -> RegionMaterials:
    """A region of one grey, hardly spread."""
    return RegionMaterials(
        np.full((1, 3), color), np.array([0.01]), np.array([roughness]), np.array([metallic])
    )


@pytest.mark.parametrize(
    "step,m,a", [(8, 0.0, 0.9), (14, 0.5, 0.9), (24, 0.0, 0.3), (24, 0.5, 0.9), (24, 1.0, 0.9)]
)
def test_light_off_the_object_equals_the_path_tracers(bowl, step, m, a):
    """A bowl lights itself: up to a third of what is seen. A rough metal gives off much less than
    its base colour says.
    """
    renderer, observations = bowl
    light = numpy_rng(1).uniform(0.2, 1.0, (8, 16, 3)).astype(np.float32)
    rows = choose_rows(observations, renderer.scene, 80, 3, seeded(0))
    transport = Transport(renderer.scene, renderer.mesh, observations, rows, 8, 40, seeded(0))
    n = len(rows.point)
    # two of the metals are rougher than there are
    lobes = LobeTable.trace(transport, 0.1, 0, swallowed=1.0)
    data = RowData.plain(
        transport, lobes, np.ones((n, 3)), np.zeros(80, int), renderer.max_depth - 1
    )
    likelihood = RowLikelihood.at(
        Mixer(data), Noise(0.3, np.ones(n)), one_material(a, step, m), np.zeros((3, 80), int)
    )
    U, W = likelihood.predict(light.reshape(-1, 3))
    renderer.set(uniform(light, lobes.roughness[step], m, a))
    truth = traced(renderer, observations, rows, 512)
    assert abs((a * U + W).mean() / truth.mean() - 1) < 0.03


def test_lobes_between_the_traced_ones(transport, light):
    """Highlights of interpolated lobes against traced ones: nearer than either neighbour."""
    lobes = LobeTable.trace(transport, 0.2, 0)
    highlights = lambda F: np.asarray(F)[1:3] @ light.astype(np.float32)
    for step in (6, 10, 18):
        truth = highlights(transport.at(lobes.roughness[step], 5)[0])
        error = lambda F, truth=truth: np.sqrt(((highlights(F) / truth - 1) ** 2).mean())
        beside = [error(lobes.direct[step // BETWEEN + k]) for k in (0, 1)]
        assert error(lobes.at(step)) < 0.1
        assert error(lobes.at(step)) < 0.7 * min(beside)
    assert np.allclose(lobes.roughness[::BETWEEN], TRACED[2:])
    assert len(lobes.roughness) == 5 * BETWEEN + 1

    nodes = numpy_rng(0).random((len(transport.node_position), 3))
    off = [0.5 * (a @ nodes + b @ nodes) for a, b in zip(lobes.off[1], lobes.off[2])]
    np.testing.assert_allclose(
        lobes.apply(light, nodes)[6],
        lobes.at(6).numpy() @ light.astype(np.float32) + off,
        rtol=1e-4,
    )


def test_metals_are_no_rougher_than_their_lobe_keeps_light(transport):
    """All of METALLIC up to roughness .65, where a white metal reflects .75; at 1, with .38, none;
    a point's offset leads no further.
    """
    lobes = LobeTable.trace(transport, 0.2, 0)
    most = dict(zip(lobes.roughness, lobes.most_metallic))
    assert most[0.25] == most[0.65] == 1 and most[1.0] == 0
    assert (np.diff(lobes.most_metallic) <= 0).all()

    n = len(transport.rows.point)
    data = RowData.plain(transport, lobes, np.ones((n, 3)), np.zeros(2, int), 1)
    rough = one_material(0.5, len(most) - 1, 0.0)
    offsets = np.array([[0, 0], [0, OTHER], [0, 0]])
    np.testing.assert_allclose(point_materials(data, rough, offsets)[1], [0, 0])
