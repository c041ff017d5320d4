"""The ground as geometry and the light that photos look into."""

import cv2
import numpy as np
import pytest

from pipeline.base.config import Observe
from pipeline.base.images import read_exr, read_png, write_exr, write_png
from pipeline.geometry.cameras import Rig, View, save_cameras
from pipeline.posterior.split_gibbs.lobes import mix
from pipeline.render.envmap import directions, uv_from_direction
from pipeline.render.observe import Observations, make_observations
from pipeline.render.observe_surroundings import find_surroundings
from pipeline.render.renderer import Renderer
from pipeline.render.rows import choose_rows
from pipeline.render.surroundings import SIGHT_ROWS, Ground, Sightings, Surroundings
from pipeline.render.tint import tint_of
from pipeline.render.transport import Transport
from tests.conftest import look_at
from tests.render.test_transport import seen, traced, uniform
from tests.seeds import numpy_rng, seeded

HEIGHT = -0.55


@pytest.fixture(scope="module")
def ground() -> Ground:
    """A patchy ground below the ball, brighter on one side, with a corner missing."""
    rng = numpy_rng(0)
    radiance = rng.uniform(0.1, 2, (16, 16, 3)).astype(np.float32)
    radiance[:8] *= 3
    known = np.ones((16, 16), bool)
    known[:5, :6] = False
    return Ground(HEIGHT, np.array([-1.5, -1.7]), 0.2, radiance, known)


def test_rays_meet_the_ground_where_it_is_known(ground):
    origin = np.array([[0.1, 0.5, 0.1], [0.1, 0.5, 0.1], [0.1, -2, 0.1], [-1.4, 0.5, -1.6]])
    direction = np.array([[0, -1.0, 0], [0, 1, 0], [0, 1, 0], [0, -1, 0]])
    met, radiance = ground.seen(origin, direction)
    assert met.tolist() == [True, False, False, False]  # from below, and where it is missing: none
    np.testing.assert_array_equal(radiance[0], ground.radiance[9, 8])
    assert (radiance[1:] == 0).all()


@pytest.mark.parametrize("roughness, metallic, color", [(0.15, 0.0, 0.5), (0.25, 1.0, 0.7)])
def test_rows_on_a_ground_are_those_of_the_path_tracer(
    ball, tmp_path, ground, roughness, metallic, color
):
    """T x + b against path-traced patches; without the ground's part they are far off."""
    observations = seen(ball / "mesh_uv.ply", 3, 1.2, tmp_path)
    light = numpy_rng(1).uniform(0.2, 1, (8, 16, 3)).astype(np.float32)
    light[2, 5] = 12
    renderer = Renderer(ball / "mesh_uv.ply", 32, 8, 4, ground)
    rows = choose_rows(observations, renderer.scene, 50, 3, seeded(0))
    transport = Transport(
        renderer.scene, renderer.mesh, observations, rows, 8, 20, seeded(0), 0.0, ground
    )
    renderer.set(uniform(light, roughness, metallic, color))
    truth = traced(renderer, observations, rows, 512)

    F, off = transport.at(roughness, 0)
    assert off[0].shape[1] == len(transport.node_position) + 3
    L = light.reshape(-1, 3)

    def predicted(with_ground: float) -> np.ndarray:
        off_object = transport.exitant(transport.irradiance(L), np.full((50, 3), color), 2)
        nodes = transport.with_ground(off_object)
        nodes[-3:] *= with_ground
        U, W = mix(F, metallic)
        off_U, off_W = mix(off, metallic)
        return color * (U @ L + off_U @ nodes) + W @ L + off_W @ nodes

    error = np.log(predicted(1.0) / truth)
    assert np.sqrt((error**2).mean()) < 0.13
    assert abs(error.mean()) < 0.02
    assert np.log(predicted(0.0) / truth).mean() < -0.1


def test_light_behind_the_ground_does_not_shine_through(ball, tmp_path):
    """A ground all round the ball's underside: what lies straight below it has no effect."""
    wide = Ground(
        HEIGHT, np.array([-20.0, -20]), 2.0, np.ones((20, 20, 3)), np.ones((20, 20), bool)
    )
    observations = seen(ball / "mesh_uv.ply", 3, 1.2, tmp_path)
    renderer = Renderer(ball / "mesh_uv.ply", 32, 8, 3, wide)
    rows = choose_rows(observations, renderer.scene, 30, 3, seeded(0))
    F, _ = Transport(
        renderer.scene, renderer.mesh, observations, rows, 8, 9, seeded(0), 0.0, wide
    ).at(0.8, 0)
    below = np.repeat(np.arange(8) >= 6, 16)
    assert F[0][:, below].sum() < 1e-6 * F[0].sum()


def test_cameras_do_not_see_the_ground(ball, ground):
    """Rays that miss the ball are black, with the ground below them or not."""
    renderer = Renderer(ball / "mesh_uv.ply", 32, 8, 3, ground)
    renderer.set(uniform(np.ones((8, 16, 3), np.float32), 0.5, 0.0, 0.5))
    origins = np.array([[1.0, 2, 0.5], [0, 2, 0]], np.float32)
    down = np.array([[0, -1, 0], [0, -1, 0]], np.float32)
    radiance = renderer.radiance(origins, down, seeded(0))
    assert (radiance[0] == 0).all()
    assert (radiance[1] > 0).all()


def test_surroundings_survive_the_file(ground, tmp_path):
    table = Sightings(
        np.ones((SIGHT_ROWS, 2 * SIGHT_ROWS, 3)),
        np.full((SIGHT_ROWS, 2 * SIGHT_ROWS), np.inf),
        np.zeros((SIGHT_ROWS, 2 * SIGHT_ROWS), bool),
    )
    np.savez(tmp_path / "s.npz", **Surroundings(ground, table).arrays())
    again = Surroundings.of(np.load(tmp_path / "s.npz"))
    assert again.ground is not None and again.sightings is not None
    assert again.ground.height == HEIGHT and again.ground.texel == 0.2
    np.testing.assert_array_equal(again.ground.known, ground.known)
    np.testing.assert_array_equal(again.sightings.deviation, table.deviation)


def test_pooled_cells_are_means_and_bounds():
    """Half a cell seen is enough, less is not; one saturated part makes the whole a lower bound."""
    shape = (SIGHT_ROWS, 2 * SIGHT_ROWS)
    deviation = np.full(shape, np.inf)
    deviation[0:2, 0] = deviation[0, 2] = 0.3
    radiance = np.zeros((*shape, 3))
    radiance[:, :, 1] = 4
    clipped = np.zeros(shape, bool)
    clipped[0, 0] = True
    pooled = Sightings(radiance, deviation, clipped).pooled(SIGHT_ROWS // 2)
    assert np.flatnonzero(np.isfinite(pooled.deviation)).tolist() == [0]
    np.testing.assert_allclose(pooled.radiance[0, 0], [0, 4, 0])
    assert pooled.clipped[0, 0] and pooled.clipped.sum() == 1


def rendered(view: View, wall: float | None) -> np.ndarray:
    """A photo of a striped ground below y = 0, and above it of a wall at a distance, or of a sky
    that is brighter towards +x.
    """
    origins, d = view.rays(view.pixel_centers())
    down = d[..., 1] < 0
    at = origins + (-origins[..., 1] / np.where(down, d[..., 1], -1))[..., None] * d
    stripes = 0.3 + 0.2 * np.sin(2 * at[..., 0])
    if wall is None:
        above = 0.5 + 0.4 * d[..., 0]
    else:  # a cylinder with narrow dark and bright bands
        flat, ray = origins[..., [0, 2]], d[..., [0, 2]]
        a, b = (ray**2).sum(-1), (flat * ray).sum(-1)
        t = (-b + np.sqrt(b**2 - a * ((flat**2).sum(-1) - wall**2))) / a
        end = flat + t[..., None] * ray
        above = np.where(np.arctan2(end[..., 0], end[..., 1]) % 0.35 < 0.175, 0.05, 0.9)
    return np.where(down, stripes, above)[..., None] * np.array([1, 0.8, 0.6], np.float32)


def photographed(folder, wall: float | None) -> tuple[Rig, list[View]]:
    """A ring of photos of a ball of radius .5 that stands on the ground, written to `folder`."""
    views = []
    for k in range(12):
        a = 2 * np.pi * k / 12
        pose = look_at([2.5 * np.sin(a), 0.9, 2.5 * np.cos(a)], (0, 0.5, 0))
        view = View(f"v{k}", f"images/v{k}.exr", 120, 90, 80, 80, 60, 45, pose, clip_level=2.0)
        _, d = view.rays(view.pixel_centers())
        to_ball = np.array([0, 0.5, 0]) - view.position
        across = np.linalg.norm(to_ball - (d @ to_ball)[..., None] * d, axis=-1)
        write_exr(folder / view.image, rendered(view, wall))
        write_png(folder / "masks" / f"v{k}.png", (across < 0.5) * np.uint8(255))
        views.append(view)
    plane = {"normal": [0, 1, 0], "offset": 0.0, "inlier_share": 0.7}
    rig = Rig(views, np.array([0, 0.5, 0]), 0.5, "sfm", {"plane": plane})
    save_cameras(folder / "cameras.json", rig)
    return rig, views


@pytest.fixture(scope="module")
def standing(ball, tmp_path_factory):
    """The ball's mesh, raised to stand on y = 0."""
    from pipeline.geometry.mesh_io import Mesh, load_mesh, save_mesh

    file = tmp_path_factory.mktemp("standing") / "mesh.ply"
    mesh = load_mesh(ball / "mesh_uv.ply")
    vertices = mesh.vertices - [0, mesh.vertices[:, 1].min(), 0]
    save_mesh(file, Mesh(vertices, mesh.faces, mesh.normals))
    return file


BOTH = Observe(ground=True, background=True)


def test_ground_and_far_light_are_found_in_photos(standing, tmp_path):
    rig, views = photographed(tmp_path, None)
    around, facts = find_surroundings(rig, views, tmp_path, tmp_path, standing, BOTH)
    ground, sightings = around.ground, around.sightings
    assert ground is not None and sightings is not None and facts["ground"] == "seen"
    assert abs(ground.height) < 0.01

    points = np.array([[1.0, 1, 0], [-1.2, 1, 0.4], [0, 1, -1.3]])
    met, radiance = ground.seen(points, np.tile([0, -1.0, 0], (3, 1)))
    assert met.all()
    truth = (0.3 + 0.2 * np.sin(2 * points[:, :1])) * [1, 0.8, 0.6]
    np.testing.assert_allclose(radiance, truth, atol=0.03)

    d = directions(SIGHT_ROWS, 2 * SIGHT_ROWS)
    far = np.isfinite(sightings.deviation) & (d[..., 1] > 0.02)
    assert far.mean() > 0.03
    np.testing.assert_allclose(sightings.radiance[far][:, 0], 0.5 + 0.4 * d[far][:, 0], atol=0.03)
    below = np.isfinite(sightings.deviation) & (d[..., 1] < -0.5)
    assert below.sum() > 0.9 * (d[..., 1] < -0.5).sum()  # the ground, as the object sees it


def test_what_is_not_asked_for_is_not_looked_for(standing, tmp_path):
    """Nothing is added to the table of pixels, and nothing in it is another."""
    photographed(tmp_path, None)
    for name, settings in (("off", {"tint": False}), ("on", {"ground": True, "background": True})):
        (tmp_path / name).mkdir()
        asked = Observe(pixels=2000, **settings)
        make_observations(tmp_path, tmp_path, standing, tmp_path / name, asked)
    off, on = (np.load(tmp_path / name / "observations.npz") for name in ("off", "on"))
    assert {n for n in on if n not in off} == set(Surroundings.of(on).arrays())
    assert not [n for n in off if n.startswith(("ground", "sightings"))]
    for name in off:
        np.testing.assert_array_equal(off[name], on[name])
    assert Observations(tmp_path / "off", tmp_path / "cameras.json").surroundings == Surroundings()


def test_what_is_around_has_a_tint(standing, tmp_path):
    """That of the pixels outside the masks; not of what is all but black beside the object."""
    rig, views = photographed(tmp_path, None)
    found = lambda: find_surroundings(rig, views, tmp_path, tmp_path, standing, Observe())
    around, facts = found()
    assert around.ground is None and around.sightings is None
    np.testing.assert_allclose(tint_of(around.around.radiance), facts["tint_around"])
    np.testing.assert_allclose(facts["tint_around"], tint_of(np.array([1, 0.8, 0.6])), atol=1e-3)

    for view in views:
        photo = read_exr(tmp_path / view.image)
        mask = read_png(tmp_path / "masks" / f"{view.name}.png") > 0
        write_exr(tmp_path / view.image, np.where(grown(mask)[..., None], photo, 0.01 * photo))
    around, facts = found()
    assert around == Surroundings()
    assert "black" in facts["tint_around"]

    for view in views:
        mask = np.full((90, 120), 255, np.uint8)
        mask[:3, :8] = 0
        write_png(tmp_path / "masks" / f"{view.name}.png", mask)
    around, facts = find_surroundings(rig, views, tmp_path, tmp_path, standing, Observe())
    assert around == Surroundings()
    assert "fills the photos" in facts["tint_around"]


def grown(mask: np.ndarray) -> np.ndarray:
    """A mask and the pixels beside it."""
    return cv2.dilate(mask.astype(np.uint8), np.ones((3, 3))) > 0


def test_near_walls_are_no_distant_light(standing, tmp_path):
    """Bands of a wall three metres off lie in another direction for every camera; far away they do
    not.
    """
    shares = {}
    for name, wall in (("near", 3.0), ("far", 300.0)):
        rig, views = photographed(tmp_path / name, wall)
        folder = tmp_path / name
        background = Observe(background=True)
        _, facts = find_surroundings(rig, views, folder, folder, standing, background)
        shares[name] = facts["background_share_of_sphere"]
    assert shares["near"] < 0.4 * shares["far"]


def test_photos_without_surroundings_have_none(standing, tmp_path):
    """Cut out photos show black around the object: that is no ground and no light."""
    rig, views = photographed(tmp_path, None)
    for view in views:
        write_exr(tmp_path / view.image, np.zeros((90, 120, 3)))
    around, facts = find_surroundings(rig, views, tmp_path, tmp_path, standing, BOTH)
    assert around == Surroundings()
    assert "nothing but the object" in facts["surroundings"]


def test_objects_that_hang_have_no_ground(standing, tmp_path):
    rig, views = photographed(tmp_path, None)
    rig.facts["plane"]["offset"] = -1.0
    around, facts = find_surroundings(
        rig, views, tmp_path, tmp_path, standing, Observe(ground=True)
    )
    assert around.ground is None
    assert "does not stand" in facts["ground"]


def test_cells_of_the_table_are_those_of_the_light():
    """The same place for a direction as in a light of as many rows."""
    d = directions(SIGHT_ROWS, 2 * SIGHT_ROWS)
    uv = uv_from_direction(d.reshape(-1, 3))
    assert np.floor(uv[:, 1] * SIGHT_ROWS).reshape(d.shape[:2])[5, 9] == 5
    assert np.floor(uv[:, 0] * 2 * SIGHT_ROWS).reshape(d.shape[:2])[5, 9] == 9
