"""True materials carried to another surface of the same thing."""

import numpy as np
from PIL import Image

from benchmarks import ceiling
from benchmarks.ceiling import carried, spread_points
from pipeline.geometry.cameras import Y_FROM_Z_UP
from pipeline.geometry.mesh_io import Mesh, save_mesh


def square(height: float) -> Mesh:
    """The unit square in x and y, Z-up, at a height, its UVs its x and y."""
    corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], float)
    vertices = np.column_stack([corners, np.full(4, height)])
    normals = np.tile([0.0, 0.0, 1.0], (4, 1))
    return Mesh(vertices, np.array([[0, 1, 2], [0, 2, 3]]), normals, corners)


def test_points_are_spread_over_the_surface():
    points, uv = spread_points(square(2.0), 4000, 1)
    np.testing.assert_allclose(points[:, :2], uv)
    counts = np.histogram2d(*uv.T, bins=2, range=[[0, 1], [0, 1]])[0]
    np.testing.assert_allclose(points[:, 2], 2)
    assert counts.min() > 800


def test_maps_are_carried_to_the_nearest_point(tmp_path, monkeypatch):
    """Left half red and rough, right half green and metal; the other surface lies .1 above."""
    monkeypatch.setattr(ceiling, "POINTS", 20_000)
    save_mesh(tmp_path / "mesh.ply", square(0.0))
    halves = np.zeros((64, 64, 3), np.uint8)
    halves[:, :32, 0], halves[:, 32:, 1] = 255, 255
    Image.fromarray(halves).save(tmp_path / "base_color.png")
    Image.fromarray(halves[..., 0]).save(tmp_path / "roughness.png")
    Image.fromarray(halves[..., 1]).save(tmp_path / "metallic.png")
    above = square(0.1)
    turned = Mesh(above.vertices @ Y_FROM_Z_UP[:3, :3].T, above.faces, above.normals, above.uv)

    (color, roughness, metallic), distance = carried(tmp_path, turned, 32)
    np.testing.assert_allclose(color[:, :14], np.broadcast_to([1, 0, 0], (32, 14, 3)))
    np.testing.assert_allclose(color[:, 18:], np.broadcast_to([0, 1, 0], (32, 14, 3)))
    assert (roughness[:, :14] == 1).all() and (metallic[:, 18:] == 1).all()
    np.testing.assert_allclose(distance, 0.1 / np.sqrt(2), rtol=0.02)
