"""The shipped example's cameras, for as many photos as are asked for."""

import runpy
from pathlib import Path

import numpy as np
import pytest

from tests.seeds import seeded

SCRIPT = runpy.run_path(str(Path(__file__).parents[2] / "examples" / "make_garden.py"))
AIM, DISTANCE, RINGS, cameras = (SCRIPT[n] for n in ("AIM", "DISTANCE", "RINGS", "cameras"))
SHIPPED = sum(count for _, count in RINGS)


@pytest.mark.parametrize("views", [0, 5, SHIPPED, 3 * SHIPPED + 1])
def test_no_two_of_the_cameras_stand_in_one_place(views):
    """As many as were asked for, all looking at the still life from about one distance."""
    poses = np.array(cameras(seeded(0), views))
    assert len(poses) == (views or SHIPPED)
    eye, back = poses[:, :3, 3], poses[:, :3, 2]
    apart = np.linalg.norm(eye[:, None] - eye[None], axis=-1)
    assert apart[~np.eye(len(eye), dtype=bool)].min() > 0
    distance = np.linalg.norm(eye - AIM, axis=1)
    assert np.abs(distance / DISTANCE - 1).max() < 0.3
    assert (((eye - AIM) * back).sum(1) / distance > 0.98).all()


def test_photos_as_many_as_are_shipped_are_those_that_are():
    assert (np.array(cameras(7, 0)) == np.array(cameras(7, SHIPPED))).all()
