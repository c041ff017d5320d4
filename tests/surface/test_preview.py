"""Silhouettes of a mesh."""

import numpy as np

from pipeline.geometry.mesh_io import Mesh, vertex_normals
from pipeline.surface.preview import Silhouette
from tests.conftest import sphere


def test_a_silhouette_is_what_rays_hit(ring):
    """All but pixels whose centre an edge meets, which rounding decides."""
    covered_in = Silhouette(sphere(3))
    for view in ring(4):
        found, hit = covered_in(view), covered_in.hit(view)
        assert hit.any() and not hit.all()
        assert (found != hit).sum() <= 2


def test_what_reaches_behind_the_camera_is_covered_too(ring):
    """A strip below the camera, from before it to behind it: a z-buffer would leave it out."""
    view = ring(1)[0]
    right, down, ahead = view.world_to_camera[:3, :3]
    corners = [
        view.position + 0.2 * down + across * right + along * ahead
        for along in (-1, 3)
        for across in (-1, 1)
    ]
    vertices, faces = np.array(corners), np.array([[0, 1, 2], [1, 3, 2]])
    strip = Mesh(vertices, faces, vertex_normals(vertices, faces))
    covered = Silhouette(strip)(view)
    assert covered[-1].all() and not covered[0].any()
