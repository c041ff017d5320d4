"""The object's sphere, which matched points may have found too small."""

import numpy as np
import pytest

from pipeline.base.config import Masks, Mesh
from pipeline.base.images import write_png
from pipeline.geometry.cameras import Rig
from pipeline.masks.facts import MaskFacts
from pipeline.masks.ground import sphere_region
from pipeline.masks.make import make_masks, said_of_things
from pipeline.masks.sphere import in_a_sphere_that_holds
from pipeline.photos.object_sphere import MARGIN
from pipeline.surface.make import reconstructed
from tests.masks.conftest import PAINTS

RADIUS = 0.45
BALL = ((0, 0, 0), RADIUS, PAINTS["warm"])
SMALL = 0.3  # radius of a sphere that cuts the ball


def given_by(folder, truth, out):
    """Facts of the masks stage for given masks, and the folder that it wrote."""
    for name, mask in truth.items():
        write_png(folder / "masks" / f"{name}.png", mask * np.uint8(255))
    out.mkdir()
    return make_masks(folder, out, Masks(), 1), out


def test_a_sphere_that_holds_the_object_stays(make_table, tmp_path):
    folder, rig, (truth,) = make_table([BALL])
    facts, out = given_by(folder, truth, tmp_path / "out")
    known = MaskFacts.load(out)
    assert facts["sphere_widened"] == 1.0 and facts["warnings"] == []
    assert known.radius == rig.radius and known.center == tuple(rig.center)


@pytest.mark.slow
def test_a_sphere_that_is_too_small_is_widened_and_the_surface_is_whole(make_table, tmp_path):
    folder, rig, (truth,) = make_table([BALL], radius=SMALL)
    facts, out = given_by(folder, truth, tmp_path / "out")
    known = MaskFacts.load(out)
    assert facts["sphere_widened"] == pytest.approx(known.radius / SMALL)
    assert np.linalg.norm(known.center) + RADIUS < known.radius
    assert facts["larger_than_points"] > 0.95 * RADIUS / (SMALL / MARGIN)
    assert len(facts["warnings"]) == 1 and "poses.object_size" in facts["warnings"][0]

    mesh, _ = reconstructed(rig, folder, out, Mesh(method="hull", grid=48), 1)
    sideways = np.abs(mesh.vertices).max(0)[[0, 2]]  # no photo looks at the ball from below
    assert sideways == pytest.approx(RADIUS, rel=0.1)


def test_masks_are_made_again_in_the_wider_sphere(make_table):
    """By a maker that cuts masks at the sphere, as `pipeline.masks.automatic` does."""
    _, rig, (truth,) = make_table([BALL], radius=SMALL)
    size = next(iter(truth.values())).shape[::-1]
    near = lambda scene: {v.name: sphere_region(v, scene, size) for v in scene.views}
    make = lambda scene: ({n: truth[n] & m for n, m in near(scene).items()}, {})

    cut_off = make(rig)[0]
    scene, (masks, facts) = in_a_sphere_that_holds(rig, make)
    assert any((cut_off[n] != truth[n]).any() for n in truth)
    assert all((masks[n] == truth[n]).all() for n in truth)
    assert facts["sphere_widened"] == scene.radius / SMALL > 1


def test_what_has_no_end_leaves_the_sphere_as_it_is(ring):
    rig = Rig(ring(8, 40, 3.0, 30), np.zeros(3), 0.2, "sfm")
    radii = []

    def everything(scene):
        radii.append(scene.radius)
        return {v.name: np.ones((v.height, v.width), bool) for v in scene.views}, {
            "turn": radii[-1]
        }

    scene, (_, facts) = in_a_sphere_that_holds(rig, everything)
    assert len(radii) > 1 and radii == sorted(radii)
    assert scene is rig and facts == {"turn": 0.2, "sphere_widened": None}
    assert "ends nowhere" in said_of_things(facts)[0]
