"""The spread of normals: drawn with the roughness, exactly, and kept out of what is exported."""

from itertools import product
from types import SimpleNamespace

import numpy as np
import pytest

from pipeline.posterior.split_gibbs.lobes import NO_SPREAD, LobeTable
from pipeline.posterior.split_gibbs.material_prior import log_roughness
from pipeline.posterior.split_gibbs.normal_spread import (
    draw_normal_spread,
    log_spreads,
    spreads_about,
)
from pipeline.posterior.split_gibbs.state import RegionMaterials
from pipeline.render.principled_lobes import blurred_roughness
from pipeline.surface.normal_error import per_axis
from tests.render.test_transport import scene, transport  # noqa: F401  (fixtures)
from tests.seeds import numpy_rng

ROUGHNESS = np.array([0.1, 0.2, 0.3, 0.45])
SPREADS = np.array([0.02, 0.06, 0.18])


class Curve:
    """Two points of one region and a third of another, whose rows tell which lobe each shows."""

    def __init__(self, sharpness: float):
        shown = np.log(blurred_roughness(ROUGHNESS[:, None], SPREADS))
        self.data = SimpleNamespace(
            region=np.array([0, 0, 1]),
            rows=SimpleNamespace(point=np.arange(3)),
            lobes=SimpleNamespace(
                roughness=tuple(ROUGHNESS),
                most_metallic=np.ones(4),
                spreads=SPREADS,
                blurred=np.abs(shown[..., None] - np.log(ROUGHNESS)).argmin(-1),
            ),
        )
        self.sharpness = sharpness

    def of_lobe(self, step: np.ndarray) -> np.ndarray:
        """Log-likelihood of the points (3,) at the lobes that they show."""
        return -self.sharpness * np.abs(step - np.array([1.0, 3.0, 2.0]))

    def point_values(self, U, W, materials):
        """U is the step of the lobe itself."""
        return self.of_lobe(U[:, 0])


def steps_seen() -> np.ndarray:
    """Lobes (4, 4, 3, 3) of which U, for dielectrics, is the roughness step."""
    seen = np.zeros((4, 4, 3, 3))
    seen[:, 0] = np.arange(4)[:, None, None]
    return seen


def grey() -> RegionMaterials:
    return RegionMaterials(np.full((2, 3), 0.3), np.full(2, 0.3), np.array([2, 0]), np.zeros(2))


@pytest.mark.slow
def test_draws_have_the_joint_probability():
    """Roughness of region 0 and the spreads of its two points, against all combinations."""
    model, rng = Curve(0.8), numpy_rng(0)
    offsets = np.array([[0, 1, 0], [0, 0, 0], [1, 1, 1]])
    counts = np.zeros((4, 3, 3))
    for _ in range(6000):
        drawn, moved = draw_normal_spread(model, steps_seen(), grey(), offsets, rng)
        counts[drawn.roughness[0], moved[2, 0], moved[2, 1]] += 1
    assert (moved[:2] == offsets[:2]).all()

    favour = log_roughness(tuple(ROUGHNESS))[0]
    region, point = (np.exp(log) for log in log_spreads(3))
    exact = np.zeros_like(counts)
    for step, k, one, two in product(range(4), range(3), range(3), range(3)):
        own = np.clip(step + offsets[0], 0, 3)
        shown = model.data.lobes.blurred[own, [one, two, 0]]
        prior = region[k] * point[k, one] * point[k, two] * np.exp(favour[step])
        exact[step, one, two] += prior * np.exp(model.of_lobe(shown)[:2].sum())
    exact /= exact.sum()
    deviation = np.sqrt(exact * (1 - exact) / counts.sum())
    assert (np.abs(counts / counts.sum() - exact) < 4.5 * deviation + 1e-9).all()


def test_exact_normals_have_no_spread():
    model = Curve(1.0)
    model.data.lobes.spreads = spreads_about(0.0)
    offsets = np.zeros((3, 3), int)
    materials, moved = draw_normal_spread(model, steps_seen(), grey(), offsets, None)
    assert moved is offsets and materials.roughness.tolist() == [2, 0]


def test_a_meshs_error_is_the_middle_of_the_spreads():
    """The median length of two deviates of .08 gives .08 back."""
    tilts = np.linalg.norm(0.08 * numpy_rng(0).normal(size=(20000, 2)), axis=1)
    spreads = spreads_about(per_axis(float(np.median(tilts))))
    assert abs(spreads[len(spreads) // 2] / 0.08 - 1) < 0.02
    assert spreads[0] < 0.03 and spreads[-1] > 0.25


def test_lobes_know_what_normals_make_of_them(transport):  # noqa: F811
    """Without spread every step shows itself. Under normals that spread by 5 degrees and more no
    lobe is sharper than .34 and none of those is traced; the roughest hardly change.
    """
    exact = LobeTable.trace(transport, 0.2, 0)
    assert (exact.blurred[:, 0] == np.arange(len(exact.roughness))).all()
    assert exact.spreads is NO_SPREAD

    table = LobeTable.trace(transport, 0.08, 0, spreads=np.radians([5, 7.5, 11]))
    shown = np.array(table.roughness)[table.blurred]
    assert shown[0, 0] > 0.33 and (np.diff(shown, axis=1) >= 0).all()
    assert (shown[-1] == 1).all() and table.usual == 1
    assert table.direct[0] is table.direct[3] and len(table.direct) == 8
    assert table.direct[3] is not table.direct[4]
