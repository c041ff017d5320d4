"""The normal map in the renderer and in the operator: Mitsuba's own frames, dense against decimated
geometry, path tracer against operator.
"""

import shutil

import numpy as np
import pytest
from scipy.ndimage import binary_erosion

from pipeline.base.runtime import mitsuba as mi
from pipeline.base.runtime import mitsuba_rays
from pipeline.geometry.mesh_io import load_mesh, save_mesh, unit
from pipeline.geometry.normal_maps import write_normal_map
from pipeline.geometry.surface import Surface
from pipeline.posterior.split_gibbs.lobes import mix
from pipeline.render.envmap import directions
from pipeline.render.renderer import MAPS, Renderer, parameter_keys
from pipeline.render.rows import Rows, choose_rows
from pipeline.render.shading_normals import shading_normals, with_normal_map
from pipeline.render.transport import Transport
from tests.conftest import bumpy_normals
from tests.render.pictures import render_view
from tests.render.test_renderer import explanation, rays_at_ball
from tests.render.test_transport import MATERIALS, seen, traced, uniform
from tests.seeds import seeded

degrees_between = lambda a, b: np.degrees(np.arccos(np.clip((unit(a) * unit(b)).sum(1), -1, 1)))


@pytest.fixture
def without_map(bumpy, tmp_path):
    """The decimated mesh in a folder of its own, without a map."""
    shutil.copy(bumpy / "mesh_uv.ply", tmp_path)
    return tmp_path / "mesh_uv.ply"


def smooth_light():
    """A light (16, 32, 3) from one side: cosine to the fourth around +X, and a dim rest."""
    toward = np.clip(directions(16, 32)[..., :1], 0, 1) ** 4
    return np.repeat(0.1 + 4 * toward, 3, -1).astype(np.float32)


def test_mitsuba_shades_with_our_normals(bumpy):
    """A chalk BSDF is proportional to the cosine: its values in three directions give the normal
    that Mitsuba shades with.
    """
    mesh = bumpy / "mesh_uv.ply"
    scene = Renderer(mesh, 8, 8, 2).scene
    si = scene.ray_intersect(mitsuba_rays(*rays_at_ball(4000)))
    chalk = mi.load_dict(with_normal_map({"type": "diffuse"}, Surface.of(mesh)))
    tripod = unit(np.array([[1, 0, 2], [-1, 1, 2], [-1, -1, 2]], float))
    value = [
        np.array(chalk.eval(mi.BSDFContext(), si, mi.Vector3f(*wo.tolist()))).mean(0)
        for wo in tripod
    ]
    local = np.linalg.solve(tripod, np.stack(value)).T

    frame = np.stack([np.array(getattr(si.sh_frame, axis)).T for axis in "stn"], 1)
    mitsubas = np.einsum("kij,ki->kj", frame, local)
    ours = shading_normals(si, Surface.of(mesh))
    assert degrees_between(mitsubas, ours).max() < 0.1
    assert np.allclose(np.linalg.norm(ours, axis=1), 1, atol=1e-5)

    truth = bumpy_normals(unit(np.array(si.p).T))
    assert np.median(degrees_between(frame[:, 2], truth)) > 6
    assert np.median(degrees_between(ours, truth)) < 1.5  # the map's filter takes a little shape


@pytest.mark.slow
def test_picture_with_map_is_the_dense_surfaces(bumpy, without_map, ring, tmp_path):
    """Against the dense surface's own path-traced picture, uniform material. Outlines differ: the
    pixels that all three pictures cover count, less a rim.
    """
    dense = load_mesh(bumpy / "dense.ply")
    dense.uv = np.full((len(dense.vertices), 2), 0.5)
    save_mesh(tmp_path / "dense.ply", dense)
    view = ring(4, 32)[0]
    chalk = uniform(smooth_light(), 0.6, 0.0, 0.5)
    picture = lambda mesh: render_view(Renderer(mesh, 32, 16, 2), chalk, view, 128)
    truth, mapped, plain = (
        picture(mesh) for mesh in (tmp_path / "dense.ply", bumpy / "mesh_uv.ply", without_map)
    )
    inside = np.all([p.sum(-1) > 0 for p in (truth, mapped, plain)], 0)
    inside = binary_erosion(inside, iterations=2)
    error = lambda p: np.abs(p - truth)[inside].mean() / truth[inside].mean()
    assert error(plain) > 0.06
    assert error(mapped) < 0.4 * error(plain)


def test_textures_are_found_whatever_the_material_is_wrapped_in(bumpy, without_map):
    """By what they are called: in a mask within a normal map as well."""
    surface = Surface.of(bumpy / "mesh_uv.ply")
    size = {"base_color": 3, "roughness": 1, "metallic": 1}
    blank = lambda n: mi.TensorXf(np.full((4, 4, n), 0.5, np.float32))
    texture = lambda n: {"type": "bitmap", "raw": True, "data": blank(n)}
    material = lambda: {"type": "principled"} | {name: texture(n) for name, n in size.items()}
    masked = lambda: {"type": "mask", "opacity": 0.5, "b": material()}
    shape = {"type": "ply", "filename": str(without_map)}
    mapped = [with_normal_map(kind(), surface) for kind in (material, masked)]
    for bsdf in (material(), *mapped):
        scene = mi.load_dict({"type": "scene", "obj": shape | {"bsdf": bsdf}})
        params = mi.traverse(scene)
        found = parameter_keys(params.keys())
        assert [params[found[name]].shape for name in MAPS] == [(4, 4, n) for n in size.values()]


def test_a_surface_knows_its_map(bumpy, without_map):
    """It is found, copied and written by the surface alone."""
    surface = Surface.of(bumpy / "mesh_uv.ply")
    plain = Surface.of(without_map)
    assert plain.normal_map is None and plain.normals is None
    again = plain.with_normals(2 * surface.normals - 1)
    assert again == Surface.of(without_map)
    np.testing.assert_allclose(again.normals, surface.normals, atol=1 / 65535)
    assert len(again.geometry.faces) == len(surface.geometry.faces)


def test_a_flat_map_changes_nothing(bumpy, without_map):
    rays = rays_at_ball(500)
    x = explanation()
    renderer = Renderer(without_map, 8, 8, 3)
    renderer.set(x)
    plain = renderer.radiance(*rays, seeded(1))

    write_normal_map(without_map.with_name("normal.png"), np.broadcast_to([0, 0, 1.0], (16, 16, 3)))
    mapped = Renderer(without_map, 8, 8, 3)
    mapped.set(x)
    assert np.allclose(mapped.radiance(*rays, seeded(1)), plain, rtol=1e-2, atol=1e-3)


def test_gradients_reach_the_maps_below_a_normal_map(bumpy):
    renderer = Renderer(bumpy / "mesh_uv.ply", 8, 8, 3)
    rays = [np.stack([r] * 4) for r in rays_at_ball(300)]
    slope = renderer.gradient(
        explanation(), *rays, 300, lambda p: (float(p.sum()), np.ones_like(p)), 0
    )
    assert (slope.base_color.sum((0, 1)) > 0).all() and np.abs(slope.roughness).max() > 0
    assert slope.light.sum() > 0


@pytest.mark.parametrize("r,m,a", MATERIALS)
def test_operator_equals_path_tracer_with_a_map(bumpy, without_map, tmp_path, r, m, a):
    """As without a map (test_transport.py), at pixels by themselves: a mean over bumps is tested
    there. And the map matters to these rows.
    """
    mesh = bumpy / "mesh_uv.ply"
    observations = seen(mesh, 3, 1.2, tmp_path)
    renderer = Renderer(mesh, 32, 16, 2)
    patches = choose_rows(observations, renderer.scene, 60, 3, seeded(0))
    rows = Rows(patches.observation, patches.point)
    light = smooth_light()
    predicted = lambda path: operator(path, observations, rows, light, r, m, a)
    renderer.set(uniform(light, r, m, a))
    truth = traced(renderer, observations, rows, 256)
    error = lambda value: np.abs(value - truth).mean() / truth.mean()
    mapped = predicted(mesh)
    assert abs(mapped.mean() / truth.mean() - 1) < 0.02
    assert error(mapped) < 0.06
    assert error(predicted(without_map)) > 2 * error(mapped)


def operator(mesh, observations, rows, light, r, m, a):
    """Radiance (n, 3) of the rows by the operator on `mesh`, direct light only."""
    scene = Renderer(mesh, 8, 8, 2).scene
    transport = Transport(scene, mesh, observations, rows, 16, 20, seeded(0))
    U, W = mix(transport.at(r, 1)[0] @ light.reshape(-1, 3), m)
    return a * U + W
