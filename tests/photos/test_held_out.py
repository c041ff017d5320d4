"""Photos that are kept for scoring: chosen once, placed by what the others have made."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pycolmap
import pytest

from pipeline.base.config import Masks, Mesh, Observe
from pipeline.base.images import read_png, write_exr, write_png
from pipeline.geometry.cameras import Rig, load_cameras, save_cameras
from pipeline.photos.held_out import hold_out, matches_between, place, without_matches
from pipeline.photos.photometry import gains
from pipeline.photos.sfm import incremental_options
from tests.seeds import numpy_rng


def photos(count: int, test: int = 0) -> list[dict]:
    return [{"name": f"v{k}", "split": "test" if k < test else "fit"} for k in range(count)]


def held(marked: list[dict]) -> list[str]:
    return [p["name"] for p in marked if p["split"] == "test"]


@pytest.mark.parametrize("count, share, expected", [(30, 0.1, 3), (8, 0.01, 1), (7, 0.01, 0)])
def test_a_random_share_is_held_out(count, share, expected):
    marked = hold_out(photos(count), Observe(held_out=share))
    assert len(held(marked)) == expected and len(marked) == count
    assert held(marked) == held(hold_out(photos(count), Observe(held_out=share)))


def test_nothing_is_held_out_where_that_is_asked_for_and_test_photos_of_the_users_suffice():
    assert held(hold_out(photos(30), Observe(held_out=0))) == []
    assert held(hold_out(photos(30, 2), Observe(held_out=0.5))) == ["v0", "v1"]


def test_a_model_does_not_end_where_it_shares_photos_with_others():
    """COLMAP's own limit of 20 cut the only model that could take all of a set's 46 photos."""
    assert incremental_options(1).max_model_overlap >= 100_000


def two_halves(count: int, bridges: list[int]) -> np.ndarray:
    """Points in common of photos in two halves, all of either alike; `bridges` show both."""
    half = np.arange(count) < count // 2
    matches = np.where(half[:, None] == half, 200, 0)
    matches[bridges] = matches[:, bridges] = 80
    np.fill_diagonal(matches, 0)
    return matches


@pytest.mark.parametrize("bridges", [[4], [4, 15]])
def test_the_last_photo_that_connects_two_halves_is_not_held_out(bridges):
    """Whichever the share; one of two may be, and as many others as were asked for are."""
    marked = photos(20)
    for share in (0.1, 0.3, 0.5):
        out = held(hold_out(marked, Observe(held_out=share), two_halves(20, bridges)))
        assert len(out) == round(share * 20)
        assert set(out) < {p["name"] for p in marked} and not {f"v{k}" for k in bridges} <= set(out)


def test_photos_that_match_well_are_held_out_as_without_matches():
    marked = photos(30)
    well = np.full((30, 30), 500)
    assert held(hold_out(marked, Observe(), well)) == held(hold_out(marked, Observe()))


def test_photos_that_would_be_placed_badly_are_held_out_last():
    few = np.full((20, 20), 200)
    badly = [3, 7, 8, 15, 19]
    few[badly] = few[:, badly] = 50
    np.fill_diagonal(few, 0)
    for share in (0.1, 0.5):
        out = held(hold_out(photos(20), Observe(held_out=share), few))
        assert len(out) == round(share * 20)
        assert not set(out) & {f"v{k}" for k in badly}

    all_badly = np.where(few > 0, 50, 0)
    assert len(held(hold_out(photos(20), Observe(held_out=0.5), all_badly))) == 10


def test_a_chain_gives_its_ends_only():
    """Each photo connects its neighbours alone: what is held out is cut off from an end."""
    chain = 200 * (np.abs(np.subtract.outer(np.arange(12), np.arange(12))) == 1)
    out = {int(name[1:]) for name in held(hold_out(photos(12), Observe(held_out=0.25), chain))}
    rest = sorted(set(range(12)) - out)
    assert len(out) == 3 and rest == list(range(rest[0], rest[-1] + 1))


@pytest.fixture(scope="module")
def matched(tmp_path_factory) -> tuple[Path, pycolmap.Reconstruction]:
    """COLMAP's database of nine photos with exact features and matches, and the truth."""
    folder = tmp_path_factory.mktemp("matched")
    options = pycolmap.SyntheticDatasetOptions()
    options.num_rigs, options.num_cameras_per_rig, options.num_frames_per_rig = 1, 1, 9
    options.num_points3D, options.num_points2D_without_point3D = 200, 5
    pycolmap.set_random_seed(0)
    with pycolmap.Database.open(str(folder / "all.db")) as database:
        truth = pycolmap.synthesize_dataset(options, database)
    return folder / "all.db", truth


def test_a_held_out_photo_is_placed_by_the_others_and_makes_none_of_their_points(matched, tmp_path):
    database, truth = matched
    file = sorted(image.name for image in truth.images.values())[4]
    without_matches(database, tmp_path / "mapped.db", [file])
    options = pycolmap.IncrementalPipelineOptions()
    options.num_threads = 1
    (tmp_path / "model").mkdir()
    models = pycolmap.incremental_mapping(
        tmp_path / "mapped.db", tmp_path, tmp_path / "model", options
    )
    model = models[0]
    assert model.num_reg_images() == 8
    assert file not in {image.name for image in model.images.values() if image.has_pose}

    placed = place(database, model, [file])[file]
    image = next(i for i in truth.images.values() if i.name == file)
    pixels = np.array([p.xy for p in image.points2D])
    xyz = np.array([model.points3D[p].xyz for p in placed.points])
    seen = np.array([placed.camera.img_from_cam(placed.pose * p) for p in xyz])
    apart = np.linalg.norm(seen[:, None] - pixels, axis=-1).min(1)
    assert len(xyz) > 50 and np.median(apart) < 0.5


def test_matches_are_those_of_the_database(matched):
    """Of nine photos with exact matches: a point that two show is in common."""
    database, truth = matched
    images = sorted((i for i in truth.images.values()), key=lambda image: image.name)
    shown = [{p.point3D_id for p in i.points2D if p.has_point3D()} for i in images]
    found = matches_between(database, [image.name for image in images])
    assert (found == found.T).all() and (np.diag(found) == 0).all()
    for k, one in enumerate(shown):
        for j, other in enumerate(shown[:k]):
            assert found[k, j] == len(one & other)


def test_a_photo_that_matches_nothing_is_not_placed(matched, tmp_path):
    database, truth = matched
    file = sorted(image.name for image in truth.images.values())[0]
    without_matches(database, tmp_path / "alone.db", [file])
    assert place(tmp_path / "alone.db", truth, [file]) == {}


def test_a_held_out_photos_gain_is_found_and_changes_no_other():
    rng = numpy_rng(0)
    stops = np.array([0.5, -0.5, 1.0, -1.0, 2.0])[:, None] * np.ones(3)
    seen = rng.uniform(-3, 0, (200, 3)) + stops[:, None] + 0.05 * rng.normal(size=(5, 200, 3))
    fit = np.array([True, True, True, True, False])
    found = gains(seen, fit)
    np.testing.assert_allclose(found, stops, atol=0.05)
    seen[4] += 3.0
    other = gains(seen, fit)
    assert np.array_equal(other[:4], found[:4]) and np.allclose(other[4], found[4] + 3)


def test_the_rig_without_its_test_views(ring, tmp_path):
    views = [replace(v, split="test" if k == 2 else "fit") for k, v in enumerate(ring(5, 16))]
    save_cameras(tmp_path / "cameras.json", Rig(views, np.zeros(3), 1.0, "sfm"))
    rig = load_cameras(tmp_path / "cameras.json")
    assert [v.name for v in rig.training().views] == ["v0", "v1", "v3", "v4"]
    assert [v.name for v in rig.test_views()] == ["v2"]


def test_masks_for_scoring_are_the_surfaces_or_the_users(ring, tmp_path):
    from pipeline.surface.make import scoring_masks
    from tests.conftest import sphere

    views = [replace(v, split="test" if k < 2 else "fit") for k, v in enumerate(ring(5, 32))]
    rig = Rig(views, np.zeros(3), 1.0, "sfm")
    (tmp_path / "given").mkdir()
    own = np.zeros((32, 32), np.uint8)
    own[3:9, 4:8] = 255
    write_png(tmp_path / "given" / "v1.png", own)
    (tmp_path / "out").mkdir()
    scoring_masks(rig, tmp_path / "given", sphere(3), tmp_path / "out")
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == ["v0.png", "v1.png"]
    assert np.array_equal(read_png(tmp_path / "out" / "v1.png"), own)
    pixels = views[0].pixel_centers()
    origins, directions = views[0].rays(pixels)
    closest = np.linalg.norm(np.cross(origins, directions), axis=-1)
    drawn = read_png(tmp_path / "out" / "v0.png") > 127
    assert (drawn == (closest < 0.5)).mean() > 0.97


@pytest.mark.slow
def test_no_stage_looks_at_a_photo_that_is_held_out(ring, tmp_path):
    """It is not even there; and its mask comes from the surface that the others show."""
    from pipeline.masks.make import make_masks
    from pipeline.surface.make import make_mesh

    views = [replace(v, split="test" if k == 3 else "fit") for k, v in enumerate(ring(9, 48))]
    for name in ("poses/images", "poses/masks", "masks", "mesh"):
        (tmp_path / name).mkdir(parents=True)
    poses = tmp_path / "poses"
    save_cameras(poses / "cameras.json", Rig(views, np.zeros(3), 0.7, "transforms.json"))
    for v in views:
        if v.split == "fit":
            origins, directions = v.rays(v.pixel_centers())
            inside = np.linalg.norm(np.cross(origins, directions), axis=-1) < 0.5
            write_png(poses / "masks" / f"{v.name}.png", inside * np.uint8(255))
            write_exr(poses / v.image, np.where(inside[..., None], 0.5, 0.1), half=True)

    facts = make_masks(poses, tmp_path / "masks", Masks(), 1)
    assert facts["method"] == "given" and "v3" not in facts["given"]
    settings = Mesh(method="hull", grid=48, faces=500)
    make_mesh(poses, tmp_path / "masks", tmp_path, tmp_path / "mesh", settings, 1)
    origins, directions = views[3].rays(views[3].pixel_centers())
    disc = np.linalg.norm(np.cross(origins, directions), axis=-1) < 0.5
    drawn = read_png(tmp_path / "mesh" / "masks" / "v3.png") > 127
    assert (drawn & disc).sum() > 0.9 * (drawn | disc).sum()
