import numpy as np
import pytest

from pipeline.base.config import Atlas
from pipeline.base.errors import InputError
from pipeline.base.runtime import import_open3d
from pipeline.geometry.cameras import Rig
from pipeline.geometry.mesh_io import Mesh, load_mesh, normal_wobble, save_mesh, vertex_normals
from pipeline.geometry.voxels import Grid
from pipeline.masks.agreement import agreement, hull_points
from pipeline.surface.atlas import judge, make_atlas
from pipeline.surface.clean import Decimation, facts, signed_volume, to_mesh
from pipeline.surface.depth import Depth
from pipeline.surface.field import hull_of
from pipeline.surface.fusion import fuse
from pipeline.surface.given import given_mesh
from pipeline.surface.raster import rasterize
from pipeline.surface.silhouettes import coarse_hull, silhouettes_of
from tests.seeds import numpy_rng


def silhouettes(views, radius=0.5):
    """Masks of a sphere at the origin, by the distance of each ray to it."""
    out = {}
    for v in views:
        u, w = np.meshgrid(np.arange(v.width) + 0.5, np.arange(v.height) + 0.5)
        o, d = v.rays(np.stack([u, w], -1))
        out[v.name] = np.linalg.norm(np.cross(o, d), axis=-1) < radius
    return out


@pytest.fixture
def sphere(ring):
    views = ring(14, 96)
    return Rig(views, np.zeros(3), 0.8, "transforms.json"), silhouettes(views)


@pytest.mark.slow
def test_hull_of_a_sphere_is_the_sphere(sphere):
    rig, masks = sphere
    points, margin = coarse_hull(rig, masks)
    grid = Grid.over(points.min(0) - margin, points.max(0) + margin, 48)
    field = hull_of(grid, rig.views, [masks[v.name] for v in rig.views], 4 * grid.cell, 0.0)
    mesh = Decimation(to_mesh(field, grid)).to(1500)
    found = facts(mesh)
    radius = np.linalg.norm(mesh.vertices, axis=1)
    assert (
        found["watertight"] and found["parts"] == 1 and signed_volume(mesh.vertices, mesh.faces) > 0
    )
    assert 0.46 < np.percentile(radius, 5) and np.percentile(radius, 95) < 0.62


def test_one_bad_mask_neither_carves_nor_goes_unnoticed(sphere):
    rig, masks = sphere
    masks["v3"] = masks["v3"] & (np.arange(96) > 50)
    found = agreement(rig, masks)
    assert not found["v3"]["carve"] and sum(f["carve"] for f in found.values()) == 13
    assert len(hull_points(rig, masks)[0]) > 0


def test_given_masks_say_where_the_object_ends_and_not_a_plane_through_it(sphere):
    rig, masks = sphere
    rig.facts["plane"] = {"offset": 0.1}
    assert silhouettes_of(rig, masks, set(masks), given=False).ground == 0.1
    assert silhouettes_of(rig, masks, set(masks), given=True).ground is None
    assert silhouettes_of(rig, masks, set(masks), given=True).grid(32).low[1] < -0.5


def test_masks_are_believed_as_far_as_they_agree(sphere):
    """Where all agree the hull is strict; one mask that denies half of the object is outvoted."""
    rig, masks = sphere
    strict = silhouettes_of(rig, masks, set(masks), given=True)
    assert strict.tolerance == 0

    masks["v3"] = masks["v3"] & (np.arange(96) > 50)
    outvoted = silhouettes_of(rig, masks, set(masks), given=True)
    assert outvoted.tolerance > 0
    grid = outvoted.grid(40)
    volume = lambda seen: (seen.hull(grid, seen.tolerance) > 0).sum()
    assert volume(outvoted) > 0.95 * volume(strict)


def test_masks_without_common_volume_are_named(sphere):
    rig, masks = sphere
    with pytest.raises(InputError, match="no volume in common"):
        coarse_hull(rig, {n: np.zeros_like(m) for n, m in masks.items()})


@pytest.mark.slow
def test_fusing_a_nearer_surface_carves_the_hull(sphere):
    """Depth maps of a smaller ball inside the hull of a larger one."""
    rig, masks = sphere
    grid = Grid.over(np.full(3, -0.6), np.full(3, 0.6), 40)
    hull = hull_of(grid, rig.views, [masks[v.name] for v in rig.views], 4 * grid.cell, 0.0)
    depths = []
    for v in rig.views:
        u, w = np.meshgrid(np.arange(v.width) + 0.5, np.arange(v.height) + 0.5)
        o, d = v.rays(np.stack([u, w], -1))
        b = (o * d).sum(-1)
        root = b**2 - ((o**2).sum(-1) - 0.35**2)
        depth = np.where(root > 0, -b - np.sqrt(np.maximum(root, 0)), 9.0) * (
            d @ v.world_to_camera[2, :3]
        )  # 9: far ground
        facing = np.broadcast_to(np.float32([0, 0, -1]), (*depth.shape, 3))
        count = np.full(depth.shape, 3, np.float32)
        depths.append(Depth(v, depth.astype(np.float32), facing, count))
    mesh = to_mesh(fuse(grid, hull, hull, depths)[0], grid)
    assert abs(np.median(np.linalg.norm(mesh.vertices, axis=1)) - 0.35) < 0.03


def test_meshes_survive_the_disk(tmp_path, ball):
    mesh = load_mesh(ball / "mesh_uv.ply")
    for name in ("a.ply", "b.obj"):
        save_mesh(tmp_path / name, mesh)
        back = load_mesh(tmp_path / name)
        corners = lambda m: np.concatenate([m.vertices[m.faces], m.uv[m.faces]], -1)
        assert np.allclose(corners(back), corners(mesh), atol=1e-4), name


def test_given_mesh_is_turned_like_its_cameras(tmp_path, ball):
    from pipeline.geometry.cameras import Y_FROM_Z_UP

    mesh = load_mesh(ball / "mesh_uv.ply")
    save_mesh(
        tmp_path / "mesh.ply", Mesh(mesh.vertices + [0, 0, 5.0], mesh.faces, mesh.normals, mesh.uv)
    )
    rig = Rig([], np.zeros(3), 1.0, "transforms.json", {"world": Y_FROM_Z_UP})
    given = given_mesh(tmp_path, rig)
    assert np.allclose(
        given.vertices.mean(0),
        mesh.vertices.mean(0)[[0, 2, 1]] * [1, 1, -1] + [0, 5, 0],
        atol=1e-3,
    )
    assert np.allclose(given.uv[given.faces], mesh.uv[mesh.faces], atol=1e-6)
    with pytest.raises(InputError, match="no cameras"):
        given_mesh(tmp_path, Rig([], np.zeros(3), 1.0, "sfm", {}))


def test_atlas_has_no_overlap_and_faces_outward(ball):
    mesh = load_mesh(ball / "mesh_uv.ply")
    found = judge(mesh.uv, mesh.faces, 512)
    assert found["overlap"] < 1e-3 and found["in_range"] and found["utilisation"] > 0.3
    assert (
        facts(mesh)["faces"] == len(mesh.faces) and (mesh.normals * mesh.vertices).sum(1).min() > 0
    )


@pytest.mark.slow
def test_overlapping_uvs_are_unwrapped_anew_and_good_ones_kept(tmp_path, ball):
    mesh = load_mesh(ball / "mesh_uv.ply")
    save_mesh(tmp_path / "good.ply", mesh)
    save_mesh(tmp_path / "bad.ply", Mesh(mesh.vertices, mesh.faces, mesh.normals, mesh.uv % 0.3))
    (tmp_path / "a").mkdir(), (tmp_path / "b").mkdir()
    good = make_atlas(tmp_path / "good.ply", tmp_path / "a", Atlas(resolution=64))
    assert good["charts"] is None and "own UVs" in good["packed_by"]
    found = make_atlas(tmp_path / "bad.ply", tmp_path / "b", Atlas(resolution=64))
    assert found["charts"] and "overlap" in found["why"] and found["overlap"] == 0
    assert found["packed_by"].startswith("xatlas") and found["mirrored"] == 0
    tight = make_atlas(tmp_path / "bad.ply", tmp_path / "b", Atlas(resolution=64, packer="tight"))
    assert tight["packed_by"] == "heliograph" and tight["overlap"] == tight["mirrored"] == 0
    assert tight["charts"] == found["charts"] and tight["utilisation"] != found["utilisation"]
    kept = load_mesh(tmp_path / "a" / "mesh_uv.ply")
    assert np.allclose(kept.uv[kept.faces], mesh.uv[mesh.faces], atol=1e-5)


def test_wobble_of_normals_is_that_of_their_noise():
    """An even sphere has none; normals tilted by 4 degrees per axis wobble by such tilts' median
    length, 1.18 times 4, and the mean of six neighbours' noise on top.
    """
    o3d = import_open3d()
    ico = o3d.geometry.TriangleMesh.create_icosahedron().subdivide_loop(4)
    unit = lambda v: v / np.linalg.norm(v, axis=1, keepdims=True)
    even = unit(np.asarray(ico.vertices))
    assert normal_wobble(Mesh(even, np.asarray(ico.triangles), even)) < np.radians(0.1)
    tilted = unit(even + np.radians(4) * numpy_rng(0).normal(size=even.shape))
    expected = np.radians(4) * np.sqrt(2 * np.log(2)) * np.sqrt(7 / 6)
    assert (
        abs(normal_wobble(Mesh(even, np.asarray(ico.triangles), tilted)) - expected)
        < 0.05 * expected
    )


def test_vertex_normals_of_a_triangle():
    assert np.allclose(vertex_normals(np.eye(3)[[0, 1, 2]], np.array([[0, 1, 2]])), 1 / np.sqrt(3))


def test_covering_triangles_are_counted_texel_by_texel():
    """Against the three edges' signs at every texel centre, some triangles beyond the square."""
    rng = numpy_rng(0)
    uv = rng.uniform(-0.3, 1.3, (60, 2))
    faces = np.array([rng.choice(60, 3, replace=False) for _ in range(40)])
    u, v = np.meshgrid((np.arange(32) + 0.5) / 32, 1 - (np.arange(32) + 0.5) / 32)
    count = np.zeros((32, 32), int)
    clear = np.ones((32, 32), bool)  # of every edge by more than rounding
    for corners in uv[faces]:
        ends = np.roll(corners, -1, axis=0)
        sides = [
            (q[0] - p[0]) * (v - p[1]) - (q[1] - p[1]) * (u - p[0]) for p, q in zip(corners, ends)
        ]
        count += (np.min(sides, 0) > 0) | (np.max(sides, 0) < 0)
        clear &= np.min(np.abs(sides), 0) > 1e-5
    assert (rasterize(uv, faces, 32) == count)[clear].all() and count.max() > 3
    assert clear.mean() > 0.98
