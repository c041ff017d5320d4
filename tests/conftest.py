"""Shared pieces: the tiers of the tests, a small closed mesh with an atlas, cameras around it, and
scene folders in temporary places.

Every test belongs to one tier, and its marker is set here:

    dag     in tests/dag: whole stages as processes, through the workflow
    heavy   in tests/heavy: minutes each; the only tier that a plain `pytest` leaves out
    slow    marked `slow` by hand, or in need of the posterior's scene (the fixture `toy`): seconds
            each, because what they test is a whole chain
    unit    all others: `pytest -m unit`
"""

from pathlib import Path

import numpy as np
import pytest

from pipeline.base import runtime
from tests import seeds

# The tests are small, and two workers share the cores: threads that wait for each other on a busy
# machine are ten times slower than one.
runtime.set_threads(1)

TESTS = Path(__file__).resolve().parent
LONGEST_FIRST = ("heavy", "dag", "slow", "unit")
COLLECTED = pytest.StashKey[list]()  # all tests found, those left out by -m too


def pytest_addoption(parser):
    parser.addoption(
        "--seed-offset",
        type=int,
        default=0,
        metavar="N",
        help="added to every seed of the tests: they hold for all of them",
    )


def pytest_configure(config):
    seeds.offset = config.getoption("--seed-offset")


def tier_of(path: Path, marks: set[str], fixtures=()) -> str:
    """Tier of a test in the file `path` with these markers set by hand and these fixtures.
    ValueError where the markers contradict the place.
    """
    folder = path.relative_to(TESTS).parts[0]
    slow = "slow" in marks or "toy" in fixtures
    tier = folder if folder in ("dag", "heavy") else "slow" if slow else "unit"

    others = marks & {"unit", "slow", "dag", "heavy"} - {tier}
    if others:
        raise ValueError(f"{path}: a test of the tier {tier} is marked {sorted(others)}")
    return tier


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config, items):
    """Mark every test with its tier, before -m selects; files with long tests come first, so that
    no worker begins one while the other has nothing left.
    """
    rank: dict[Path, int] = {}
    for item in items:
        marks = {mark.name for mark in item.iter_markers()}
        tier = tier_of(item.path, marks, item.fixturenames)
        item.add_marker(tier)
        place = LONGEST_FIRST.index(tier)
        rank[item.path] = min(place, rank.get(item.path, place))
    items.sort(key=lambda item: rank[item.path])
    config.stash[COLLECTED] = list(items)


def look_at(eye, target=(0, 0, 0), up=(0, 1, 0)) -> np.ndarray:
    """World-to-camera matrix with OpenCV axes."""
    eye, target = np.asarray(eye, float), np.asarray(target, float)
    z = target - eye
    z /= np.linalg.norm(z)
    x = np.cross(z, up)
    x /= np.linalg.norm(x)
    out = np.eye(4)
    out[:3, :3] = np.stack([x, np.cross(z, x), z])
    out[:3, 3] = -out[:3, :3] @ eye
    return out


@pytest.fixture
def one_thread():
    """Dr.Jit on one thread too, as in the sample stage: sums in a fixed order."""
    import drjit

    before = drjit.thread_count()
    runtime.set_threads(1)
    yield
    drjit.set_thread_count(before)


@pytest.fixture(scope="session")
def ring():
    """views(n, size, radius, elevation) -> Views on a ring around the origin."""
    from pipeline.geometry.cameras import View

    def make(n=10, size=64, radius=3.0, elevation=25.0, focal=1.4):
        out = []
        for k in range(n):
            a, e = 2 * np.pi * k / n, np.radians(elevation if k % 2 else -0.4 * elevation)
            eye = radius * np.array([np.cos(e) * np.sin(a), np.sin(e), np.cos(e) * np.cos(a)])
            out.append(
                View(
                    f"v{k}",
                    f"images/v{k}.exr",
                    size,
                    size,
                    focal * size,
                    focal * size,
                    size / 2,
                    size / 2,
                    look_at(eye),
                )
            )
        return out

    return make


def save_surface(folder: Path, distance: np.ndarray, axis: np.ndarray) -> None:
    """The zero surface of signed distances on a cubic grid, with an atlas, as a folder like the
    atlas stage's.
    """
    from skimage.measure import marching_cubes

    from pipeline.base.config import Atlas
    from pipeline.geometry.mesh_io import Mesh, save_mesh, vertex_normals
    from pipeline.surface.atlas import make_atlas

    vertices, faces, _, _ = marching_cubes(
        -distance.astype(np.float32), 0.0, gradient_direction="ascent"
    )
    vertices = vertices * (axis[1] - axis[0]) + axis[0]
    save_mesh(folder / "mesh.ply", Mesh(vertices, faces, vertex_normals(vertices, faces)))
    make_atlas(folder / "mesh.ply", folder, Atlas(resolution=64, padding=1))


@pytest.fixture(scope="session")
def ball(tmp_path_factory) -> Path:
    """A sphere of radius 0.5 as a folder."""
    folder, axis = tmp_path_factory.mktemp("ball"), np.linspace(-0.7, 0.7, 22)
    save_surface(
        folder, np.sqrt(sum(g**2 for g in np.meshgrid(axis, axis, axis, indexing="ij"))) - 0.5, axis
    )
    return folder


def sphere(subdivisions: int):
    """An even triangle mesh of the sphere of radius 0.5."""
    from pipeline.base.runtime import import_open3d
    from pipeline.geometry.mesh_io import Mesh, unit

    ico = import_open3d().geometry.TriangleMesh.create_icosahedron()
    ico = ico.subdivide_midpoint(subdivisions)
    normals = unit(np.asarray(ico.vertices))
    return Mesh(0.5 * normals, np.asarray(ico.triangles).astype(np.int64), normals)


def bumpy_radius(direction: np.ndarray) -> np.ndarray:
    """Radius (n,) of a bumpy ball in unit directions (n, 3)."""
    return 0.5 + 0.008 * np.sin(14 * direction).sum(1)


def bumpy_normals(direction: np.ndarray) -> np.ndarray:
    """Its unit normals (n, 3): the gradient of |x| - radius(x / |x|), by central differences."""
    from pipeline.geometry.mesh_io import unit

    level = lambda x: np.linalg.norm(x, axis=1) - bumpy_radius(unit(x))
    where = direction * bumpy_radius(direction)[:, None]
    step = 1e-5 * np.eye(3)
    return unit(np.stack([level(where + e) - level(where - e) for e in step], 1))


@pytest.fixture(scope="session")
def bumpy(tmp_path_factory) -> Path:
    """A ball with bumps of a hundredth, as folders of the mesh and atlas stages in one: dense.ply
    with 80 thousand triangles, mesh_uv.ply with 1280 that have lost the bumps, and normal.png.
    """
    from pipeline.base.config import Atlas
    from pipeline.geometry.mesh_io import Mesh, save_mesh
    from pipeline.surface.atlas import make_atlas
    from pipeline.surface.bake import make_normal_map

    folder = tmp_path_factory.mktemp("bumpy")
    fine = sphere(6)
    dense = fine.normals * bumpy_radius(fine.normals)[:, None]
    save_mesh(folder / "dense.ply", Mesh(dense, fine.faces, bumpy_normals(fine.normals)))
    save_mesh(folder / "mesh.ply", sphere(3))
    settings = Atlas(resolution=256, padding=2)
    make_atlas(folder / "mesh.ply", folder, settings)
    make_normal_map(folder, folder, settings)
    return folder
