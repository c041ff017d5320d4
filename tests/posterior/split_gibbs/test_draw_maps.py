"""Maps of a region: of one kind or another, never a blur of both; roughness runs over."""

import numpy as np

from pipeline.posterior.split_gibbs.draw_maps import region_maps


def test_metallic_is_what_most_points_are():
    """A dielectric of which a quarter is metal, and a lone point: the quarter has an edge, the
    point is gone; roughness is each part's own and between them at the edge.
    """
    at = (np.stack(np.mgrid[:24, :24], -1).reshape(-1, 2) + 0.5) / 24
    metal = (at < 0.5).all(1)
    lone = np.zeros(len(at), bool)
    lone[np.abs(at - [0.8, 0.8]).sum(1).argmin()] = True
    roughness = np.where(metal, 0.2, 0.6)
    found, kind = region_maps(at, roughness, (metal | lone).astype(float), 96)

    assert set(np.unique(kind)) == {0.0, 1.0}
    # row 0 is v = 1
    assert kind[60:, :36].min() == 1 and kind[:36].max() == 0 and kind[:, 60:].max() == 0
    np.testing.assert_allclose(found[70:, :26], 0.2, rtol=1e-3)
    np.testing.assert_allclose(found[:26], 0.6, rtol=1e-3)
    assert 0.25 < found[72, 48] < 0.5
