"""The linear operator against the path tracer."""

from dataclasses import replace
from types import SimpleNamespace

import drjit as dr
import numpy as np
import pytest

from pipeline.base.runtime import mitsuba as mi
from pipeline.geometry.cameras import Rig, View, save_cameras
from pipeline.geometry.mesh_io import load_mesh, save_mesh, unit
from pipeline.posterior.split_gibbs.lobes import mix
from pipeline.render.envmap import directions
from pipeline.render.light_grid import bilinear
from pipeline.render.observe import Observations, Tracer
from pipeline.render.principled_lobes import (
    LOBES,
    PrincipledLobes,
    blurred_roughness,
    principled_bsdf,
)
from pipeline.render.renderer import Explanation, Renderer
from pipeline.render.rows import CONE, PIXELS, Rows, SeenPixels, choose_rows
from pipeline.render.transport import Transport, without_error
from tests.conftest import look_at, save_surface
from tests.seeds import numpy_rng, seeded

MATERIALS = [
    (0.15, 0.0, 0.5),
    (0.7, 0.0, 0.8),
    (0.25, 1.0, 0.7),
    (0.5, 0.4, 0.3),
]  # roughness, metallic, base colour


def seen(mesh, radius, height, folder) -> Observations:
    """What a ring of 8 cameras sees of a mesh around the origin."""
    tracer = Tracer(mesh)
    views = []
    columns = {"view": [], "pixel": [], "cosine": []}
    for k in range(8):
        angle = 2 * np.pi * k / 8
        pose = look_at([radius * np.sin(angle), height, radius * np.cos(angle)])
        view = View(f"v{k}", "", 48, 48, 70, 70, 24, 24, pose)
        views.append(view)

        row, column = np.mgrid[0:48, 0:48].reshape(2, -1)
        pixel = np.stack([column, row], -1)
        _, cosine, hit = tracer.hit(*view.rays(pixel + 0.5))
        columns["view"].append(np.full(hit.sum(), k))
        columns["pixel"].append(pixel[hit])
        columns["cosine"].append(cosine[hit])

    save_cameras(folder / "cameras.json", Rig(views, np.zeros(3), 0.8, "transforms.json"))
    table = {name: np.concatenate(parts) for name, parts in columns.items()}
    n = len(table["view"])
    np.savez(
        folder / "observations.npz",
        **table,
        rgb=np.zeros((n, 3), np.float32),
        clipped=np.zeros((n, 3), bool),
        uv=np.zeros((n, 2), np.float32),
        views=np.array([v.name for v in views]),
        held_out=np.array([], str),
    )
    return Observations(folder, folder / "cameras.json")


def uniform(light, roughness, metallic, base_color) -> Explanation:
    """One material all over, textures of side 32."""
    constant = lambda v, *shape: np.full((32, 32) + shape, v, np.float32)
    return Explanation(light, constant(base_color, 3), constant(roughness), constant(metallic))


def traced(renderer, observations, rows, spp) -> np.ndarray:
    """Radiance (n, 3) of the rows' patches by the path tracer, `spp` paths each, through the
    centres of their pixels: elsewhere in a pixel a ray may pass the object by.
    """
    rays = observations.centre_rays(rows.rays(spp, numpy_rng(9)).T.ravel())
    return renderer.radiance(*rays, seeded(0)).reshape(spp, -1, 3).mean(0)


@pytest.fixture(scope="module")
def scene(ball, tmp_path_factory):
    """Renderer, observations of the ball by a ring of cameras under a light with a lamp, and that
    light.
    """
    light = numpy_rng(1).uniform(0.2, 1.0, (8, 16, 3)).astype(np.float32)
    light[2, 5] = 12
    mesh = ball / "mesh_uv.ply"
    return Renderer(mesh, 32, 8, 4), seen(mesh, 3, 1.2, tmp_path_factory.mktemp("seen")), light


@pytest.fixture(scope="module")
def bowl(tmp_path_factory):
    """A thick bowl that is open upwards, seen from above: renderer, observations."""
    folder = tmp_path_factory.mktemp("bowl")
    axis = np.linspace(-0.7, 0.7, 44)
    x, y, z = np.meshgrid(axis, axis, axis, indexing="ij")
    radius = np.sqrt(x**2 + y**2 + z**2)
    shell = np.maximum(radius - 0.6, 0.42 - radius)
    save_surface(folder, np.maximum(shell, y - 0.1), axis)

    mesh = folder / "mesh_uv.ply"
    return Renderer(mesh, 32, 8, 6), seen(mesh, 1.2, 2.4, folder)


@pytest.fixture(scope="module")
def transport(scene, ball):
    renderer, observations, _ = scene
    rows = choose_rows(observations, renderer.scene, 40, 3, seeded(0))
    return Transport(renderer.scene, ball / "mesh_uv.ply", observations, rows, 8, 20, seeded(0))


def test_lobes_make_the_principled_bsdf():
    """f = (1 - m)(a A + S) + m (a M1 + (1 - a) M0) to rounding."""
    lanes = 2000
    pairs = numpy_rng(0).normal(size=(2, 3, lanes))
    pairs /= np.linalg.norm(pairs, axis=1, keepdims=True)
    pairs[:, 2] = abs(pairs[:, 2])  # both directions above the surface
    incoming, outgoing = pairs.astype(np.float32)
    si = dr.zeros(mi.SurfaceInteraction3f, lanes)
    si.wi = mi.Vector3f(incoming)
    wo = mi.Vector3f(outgoing)

    for r, m, a in MATERIALS:
        lobes = PrincipledLobes(r)(si, wo)
        assert lobes.shape == (len(LOBES), lanes)
        U, W = mix(lobes, m)
        whole = np.array(principled_bsdf(m, a, r).eval(mi.BSDFContext(), si, wo)[0])
        np.testing.assert_allclose(a * U + W, whole, rtol=2e-3, atol=2e-5)


def test_rows_are_grouped_by_point_one_pixel_per_view(scene, transport):
    rows, observations = transport.rows, scene[1]
    assert (np.diff(rows.point) >= 0).all() and len(rows.starts) == 40
    spread = [np.ptp(transport.position[rows.point == p], axis=0).max() for p in range(40)]
    assert max(spread) < 0.15  # pixels are about .04 wide at the ball
    members = np.split(rows.patch.indices, rows.patch.indptr[1:-1])
    assert np.allclose(rows.patch.sum(1), 1) and np.mean([len(m) for m in members]) > 4
    assert max(len(m) for m in members) == PIXELS
    assert all(
        (observations.view[m] == observations.view[centre]).all() and centre in m
        for m, centre in zip(members, rows.observation)
    )
    for p in range(40):
        seen = observations.view[rows.observation[rows.point == p]]
        assert 1 <= len(seen) <= 3 and len(set(seen)) == len(seen)


@pytest.mark.parametrize("share,radius", [(1.0, 2.0), (0.1, 4.8), (0.01, 6.0)])
def test_patches_are_wider_where_few_pixels_were_drawn(share, radius):
    """Discs of eight pixels when all of them, a tenth and a hundredth of two photos were drawn; the
    pixels of one photo are no neighbours of the other's.
    """
    rng = numpy_rng(0)
    drawn = np.argwhere(rng.random((2, 120, 160)) < share)
    observations = SimpleNamespace(view=drawn[:, 0], pixel=drawn[:, 1:].astype(np.uint16))
    pixels = SeenPixels(np.arange(len(drawn)), np.zeros((0, 3)), np.zeros((0, 3)), 0.1)
    assert abs(pixels.patch_radius(observations, rng) / radius - 1) < 0.15


def test_bilinear_weights_reproduce_a_smooth_light():
    centres = directions(8, 16).reshape(-1, 3)
    index, weight = bilinear(centres, 8)
    values = numpy_rng(0).normal(size=128)
    np.testing.assert_allclose((values[index] * weight).sum(1), values, atol=1e-6)

    _, weight = bilinear(numpy_rng(1).normal(size=(50, 3)), 8)
    assert np.allclose(weight.sum(1), 1)


@pytest.mark.parametrize("r,m,a", MATERIALS)
def test_operator_equals_path_tracer(scene, transport, r, m, a):
    """A convex ball has direct light only; differences are Monte-Carlo error of both."""
    renderer, observations, light = scene
    F, off = transport.at(r, 1)
    U, W = mix(F @ light.reshape(-1, 3), m)
    renderer.set(uniform(light, r, m, a))
    truth = traced(renderer, observations, transport.rows, 512)
    assert abs((a * U + W).mean() / truth.mean() - 1) < 0.02
    assert np.abs(a * U + W - truth).mean() / truth.mean() < 0.06
    assert off[0].nnz < 0.01 * len(truth) * len(
        transport.cell_direction
    )  # next to no light off itself


def test_a_lamp_in_one_pixel_is_as_bright_as_it_is(scene, ball):
    """One jittered direction per cell must not change what a light pixel gives: chalk under lamps
    of one pixel, the light as fine as the grid.
    """
    _, observations, _ = scene
    renderer = Renderer(ball / "mesh_uv.ply", 32, 32, 2)
    rows = choose_rows(observations, renderer.scene, 40, 3, seeded(0))
    transport = Transport(
        renderer.scene, ball / "mesh_uv.ply", observations, rows, 32, 20, seeded(0)
    )
    U, W = mix(transport.at(1.0, 1)[0], 0.0)
    error = []
    for lamp in numpy_rng(3).integers(6 * 64, 16 * 64, 8):
        light = np.full((32, 64, 3), 1e-3, np.float32)
        light.reshape(-1, 3)[lamp] = 100
        renderer.set(uniform(light, 1.0, 0.0, 0.5))
        truth = traced(renderer, observations, rows, 1024)[:, 0]
        error.append((0.5 * U + W)[:, lamp].mean() * 100 / truth.mean() - 1)
    # one lamp's error has a deviation of 3 %, by where in its cells the jitter lies: bounds at
    # p < 1e-4 for the mean of eight, and for what they differ by
    assert abs(np.mean(error)) < 4.5 * 0.03 / np.sqrt(8) and np.std(error) < 2.3 * 0.03


def test_light_between_parts_adds_up():
    """Two facing nodes that each see half the light: the series of bounces against the closed
    form.
    """
    t = object.__new__(Transport)
    t.node_point, t.sees = np.array([0, 1]), np.array([[0.5], [0.5]])
    t.ground_light = np.zeros((2, 3))
    t.between = np.array([[0.0, 0.5], [0.5, 0.0]])
    irradiance = t.irradiance(np.ones((1, 3)))
    B = t.exitant(irradiance, np.full((2, 3), 0.6), 60)
    np.testing.assert_allclose(B, 0.3 / (1 - 0.3), atol=1e-9)
    np.testing.assert_allclose(t.exitant(irradiance, np.full((2, 3), 0.6), 1), 0.3)


def log_error(prediction, truth) -> float:
    """RMS of the log of a ratio."""
    return float(np.sqrt((np.log(prediction / truth) ** 2).mean()))


@pytest.fixture(scope="module")
def bumps(tmp_path_factory):
    """A ball with bumps a few pixels wide: renderer, observations, rows."""
    folder = tmp_path_factory.mktemp("bumps")
    axis = np.linspace(-0.7, 0.7, 48)
    x, y, z = np.meshgrid(axis, axis, axis, indexing="ij")
    waves = np.sin(14 * x) * np.sin(14 * y) * np.sin(14 * z)
    save_surface(folder, np.sqrt(x**2 + y**2 + z**2) - 0.5 - 0.02 * waves, axis)

    mesh = folder / "mesh_uv.ply"
    renderer, observations = Renderer(mesh, 32, 8, 2), seen(mesh, 3, 1.2, folder)
    return renderer, observations, choose_rows(observations, renderer.scene, 60, 3, seeded(0))


def test_patches_are_coherent_in_normal(bumps):
    """All pixels of a point within CONE of its normal, so any two of them within twice that."""
    renderer, observations, rows = bumps
    origins, directions = observations.centre_rays(rows.patch.indices)
    hits = renderer.scene.ray_intersect(mi.Ray3f(mi.Point3f(origins.T), mi.Vector3f(directions.T)))
    normal = np.array(hits.sh_frame.n).T
    point = np.repeat(rows.point, np.diff(rows.patch.indptr))
    least = min((normal[point == p] @ normal[point == p].T).min() for p in range(60))
    assert np.cos(np.radians(2 * CONE)) < least < np.cos(np.radians(CONE))
    assert np.mean(np.diff(rows.patch.indptr)) > 3


@pytest.mark.parametrize("r,share", [(0.15, 0.6), (0.4, 0.8)])
def test_a_curved_patch_is_the_mean_of_its_pixels(bumps, scene, r, share):
    """On bumps the mirror images of a patch spread wide: T against the path tracer's patch means,
    beside the T of the central pixels alone.
    """
    renderer, observations, rows = bumps
    light = scene[2]
    renderer.set(uniform(light, r, 1.0, 0.7))
    truth = traced(renderer, observations, rows, 256)
    errors = []
    for of_rows in (rows, Rows(rows.observation, rows.point)):
        T = Transport(renderer.scene, renderer.mesh, observations, of_rows, 8, 30, seeded(0))
        U, W = mix(T.at(r, 1)[0] @ light.reshape(-1, 3), 1.0)
        errors.append(log_error(0.7 * U + W, truth))
    assert errors[0] < 0.15 and errors[0] < share * errors[1]


def test_the_meshs_error_is_taken_out_of_the_spread():
    """Normals that spread by .02 per axis, .012 of it the mesh's: .016 stays, to five standard
    errors; none where all is. (Of wider ones the slopes, tangents, are no angles any more.)
    """
    rng = numpy_rng(0)
    normal = np.concatenate([0.02 * rng.normal(size=(50, 4000, 2)), np.ones((50, 4000, 1))], -1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    slope = lambda n: n[..., :2] / n[..., 2:]
    spread = lambda sigma: slope(without_error(normal, sigma)).std(1).mean()
    np.testing.assert_allclose(without_error(normal, 0.0), normal, atol=1e-12)
    assert abs(spread(0.012) / 0.016 - 1) < 0.01
    assert spread(0.05) < 1e-6


def test_normals_in_error_show_a_broader_lobe(ball, scene, tmp_path):
    """Photos of a smooth ball, and three meshes of it whose normals err, as those from photos: the
    lobe of alpha^2 + 2 sigma^2 explains the path-traced patch means better than the material's own.
    """
    renderer, observations, light = scene
    mesh = load_mesh(ball / "mesh_uv.ply")
    same = np.unique(mesh.vertices.round(5), axis=0, return_inverse=True)[1].ravel()
    rows = choose_rows(observations, renderer.scene, 100, 3, seeded(0))
    own, rng, errors = 0.15, numpy_rng(4), []
    renderer.set(uniform(light, own, 1.0, 0.7))
    truth = traced(renderer, observations, rows, 256)
    for k in range(3):
        error = 0.2 * rng.normal(size=(same.max() + 1, 3))
        file = tmp_path / f"noisy{k}.ply"
        save_mesh(file, replace(mesh, normals=unit(mesh.normals + error[same])))
        noisy = Renderer(file, 32, 8, 2).scene
        T = Transport(noisy, ball / "mesh_uv.ply", observations, rows, 8, 20, seeded(0), 0.08)
        mean = unit(T.frame[:, :, 2].mean(1))
        sigma = np.sqrt(((mean - unit(T.position)) ** 2).sum(1).mean() / 2)
        assert 0.05 < sigma < 0.15  # a face's normals err less than its vertices'
        for r in (own, float(blurred_roughness(own, sigma))):
            U, W = mix(T.at(r, 1)[0] @ light.reshape(-1, 3), 1.0)
            errors.append((((0.7 * U + W - truth) / (truth + 0.1)) ** 2).mean())
    # of eight seeds .72 to .86
    assert np.sqrt(np.mean(errors[1::2]) / np.mean(errors[::2])) < 0.95
