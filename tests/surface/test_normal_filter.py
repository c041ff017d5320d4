"""Noise out of normals: as much as photos leave open, and no edges."""

import numpy as np

from pipeline.geometry.mesh_io import Mesh, unit
from pipeline.surface.normal_filter import LEAST, MOST, filtered_normals, steps_of
from tests.conftest import sphere
from tests.seeds import numpy_rng

degrees_between = lambda a, b: np.degrees(np.arccos(np.clip((unit(a) * unit(b)).sum(1), -1, 1)))


def tilted(mesh, degrees):
    """A mesh with normals that are off by a normal deviate of so many degrees per axis."""
    noise = np.radians(degrees) * numpy_rng(0).normal(size=mesh.normals.shape)
    return Mesh(mesh.vertices, mesh.faces, unit(mesh.normals + noise))


def test_filter_takes_noise_and_leaves_edges():
    """A ball's normals tilted by 6 degrees per axis; and two plates that meet at right angles."""
    ball = sphere(5)
    noisy = tilted(ball, 6)
    before = np.median(degrees_between(noisy.normals, ball.normals))
    filtered = filtered_normals(noisy, np.full(len(ball.vertices), LEAST))
    assert np.median(degrees_between(filtered, ball.normals)) < 0.4 * before

    x, y = np.mgrid[0:6, 0:11].reshape(2, -1)
    plates = np.stack([x, np.minimum(y, 5), np.maximum(y - 5, 0)], 1).astype(float)
    corner = np.arange(66).reshape(6, 11)[:-1, :-1].ravel()
    faces = np.concatenate(
        [
            np.stack([corner, corner + 11, corner + 12], 1),
            np.stack([corner, corner + 12, corner + 1], 1),
        ]
    )
    flat = np.where(y[:, None] <= 5, [0, 0, 1.0], [0, -1.0, 0])
    kept = filtered_normals(Mesh(plates, faces, flat), np.full(66, 16))
    assert degrees_between(kept, flat).max() < 0.1


def test_what_photos_know_is_filtered_less():
    """One half of a noisy ball is well known; and of what is known, more is never filtered more."""
    ball = sphere(5)
    noisy = tilted(ball, 10)
    known = np.where(ball.vertices[:, 0] > 0, 10.0, 0.0)
    error = degrees_between(filtered_normals(noisy, steps_of(known)), ball.normals)
    well, badly = ball.vertices[:, 0] > 0.3, ball.vertices[:, 0] < -0.3
    assert np.median(error[badly]) < 0.8 * np.median(error[well])

    steps = steps_of(np.array([0, 1e-6, 0.01, 0.1, 0.25, 1, 1e6]))
    assert (np.diff(steps) <= 0).all() and steps[0] == MOST and steps[-1] == steps[-2] == LEAST
