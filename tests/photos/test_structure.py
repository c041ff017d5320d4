"""Structure from motion of a made-up scene, a box on a floor, with all that is known of it."""

from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pycolmap
import pytest

from pipeline.base.config import Capture, Observe, Poses
from pipeline.base.files import write_json
from pipeline.base.images import to_srgb8, write_png
from pipeline.geometry.cameras import OPENCV_FROM_OPENGL, Y_FROM_Z_UP, Rig, View, load_cameras
from pipeline.photos import sfm
from pipeline.photos.capture import capture
from pipeline.photos.poses import make_poses
from tests.conftest import look_at
from tests.seeds import numpy_rng

COUNT = 10
WIDTH, HEIGHT, FOCAL = 320, 240, 380.0
BOX = np.array([0.35, 0.5, 0.3])  # half width, height, half depth, on the floor y = 0
SETTINGS = Poses(max_size=320, features=1500, up="auto")


def texture(seed: int, size: int = 1024) -> np.ndarray:
    """Colours of all scales, (size, size, 3)."""
    rng = numpy_rng(seed)
    out = np.zeros((size, size, 3), np.float32)
    for sigma in (2.0, 6.0, 20.0):
        layer = cv2.GaussianBlur(rng.normal(size=out.shape).astype(np.float32), (0, 0), sigma)
        out += layer / layer.std()
    return np.clip(0.35 + 0.09 * out, 0.02, 1)


FLOOR, SIDES = texture(0), texture(1)


def looked_up(image: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Values at u, v in [-2, 2]."""
    at = [((c + 2) / 4 * (image.shape[0] - 1)).astype(np.float32) for c in (u, v)]
    return cv2.remap(image, *at, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)


def picture(view: View) -> np.ndarray:
    """The scene as a view sees it, (h, w, 3) linear."""
    o, d = view.rays(view.pixel_centers())
    with np.errstate(divide="ignore", invalid="ignore"):
        floor = np.where(d[..., 1] < 0, -o[..., 1] / d[..., 1], np.inf)
        one, two = ((side * BOX + [0, 0.5 * BOX[1], 0] - o) / d for side in (-1, 1))
    one = np.minimum(one, two), np.maximum(one, two)
    enter, leave = one[0].max(-1), one[1].min(-1)
    box = (enter < leave) & (enter > 0)
    p = o + np.where(box, enter, np.where(np.isfinite(floor), floor, 0))[..., None] * d
    axis = one[0].argmax(-1)
    side = np.where(axis == 0, p[..., 2], p[..., 0])
    up = np.where(axis == 1, p[..., 2], p[..., 1])
    on_box = looked_up(SIDES, side + 0.9 * axis - 0.5, up)
    on_floor = looked_up(FLOOR, p[..., 0], p[..., 2])
    sky = np.isinf(floor) & ~box
    return np.where(sky[..., None], 0.6, np.where(box[..., None], on_box, on_floor))


def views() -> list[View]:
    out = []
    for k in range(COUNT):
        a = np.radians(-60 + 120 * k / (COUNT - 1))
        eye = [2.0 * np.sin(a), 1.1 + 0.1 * (k % 3), 2.0 * np.cos(a)]
        pose = look_at(eye, (0, 0.2, 0))
        name = f"p{k}"
        out.append(View(name, "", WIDTH, HEIGHT, FOCAL, FOCAL, WIDTH / 2, HEIGHT / 2, pose))
    return out


def captured_in(folder: Path, exposure: float) -> tuple[Path, Path]:
    """Scene folder and the folder of its capture, both made in `folder`."""
    scene, out = folder / "scene", folder / "capture"
    (scene / "images").mkdir(parents=True)
    out.mkdir()
    for v in views():
        write_png(scene / "images" / f"{v.name}.png", to_srgb8(exposure * picture(v)))
    capture(scene, out, Capture(leave_out="none"))
    return scene, out


@pytest.fixture(scope="module")
def photographed(tmp_path_factory):
    """Scene folder and the folder of its capture."""
    return captured_in(tmp_path_factory.mktemp("photographed"), 1.0)


def aligned(found: np.ndarray, truth: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Scale, rotation and shift of truth ~ s R found + t (Umeyama 1991)."""
    a, b = found - found.mean(0), truth - truth.mean(0)
    u, s, v = np.linalg.svd(b.T @ a)
    sign = np.diag([1, 1, np.sign(np.linalg.det(u @ v))])
    scale = float((s * np.diag(sign)).sum() / (a**2).sum())
    turn = u @ sign @ v
    return scale, turn, truth.mean(0) - scale * turn @ found.mean(0)


def stand_where_they_were(rig: Rig) -> None:
    """Asserts that the cameras are the true ones, in their own frame; those held out, too, in the
    frame of the others.
    """
    truth = {v.name: v.position for v in views()}
    fit = rig.fit_views()
    scale, turn, shift = aligned(
        np.stack([v.position for v in fit]), np.stack([truth[v.name] for v in fit])
    )
    for v in rig.views:
        error = np.linalg.norm(scale * turn @ v.position + shift - truth[v.name])
        assert error < 0.02, v.name


@pytest.mark.slow
def test_photos_that_are_held_out_are_placed_and_nothing_is_made_from_them(photographed, tmp_path):
    scene, captured = photographed
    held = Observe(held_out=0.2)
    facts = make_poses(captured, scene, tmp_path, SETTINGS, held, 1)
    rig = load_cameras(tmp_path / "cameras.json")
    test = [v.name for v in rig.test_views()]
    assert facts["held_out"] == test and len(test) == 2 and facts["registered"] == COUNT

    stand_where_they_were(rig)
    points = np.load(tmp_path / "points.npz")
    index = [k for k, v in enumerate(rig.views) if v.split == "fit"]
    owner = np.repeat(np.arange(len(points["xyz"])), np.diff(points["offsets"]))
    made_by = np.bincount(owner[np.isin(points["views"], index)], minlength=len(points["xyz"]))
    assert made_by.min() >= 2


@pytest.mark.slow
def test_of_few_photos_none_is_spared(photographed, tmp_path, monkeypatch):
    """One attempt follows the other, up to the first that loses none; the guided one has the
    features of the attempt in photos of more contrast, matched anew.
    """
    mapped, counts, losing = sfm._mapped, {}, ("plain", "thorough", "contrast")

    def without_one(database, tag, held_out, threads):
        with pycolmap.Database.open(str(database)) as db:
            counts[tag] = db.num_keypoints(), db.num_inlier_matches()
        found, sizes = mapped(database, tag, held_out, threads)
        if tag not in losing:
            return found, sizes
        shown = SimpleNamespace(num_points3D=sfm.LEAST_POINTS)
        fewer = SimpleNamespace(reg_image_ids=lambda: range(COUNT - 1), image=lambda _: shown)
        return fewer, [COUNT - 1]

    monkeypatch.setattr(sfm, "_mapped", without_one)
    facts = make_poses(photographed[1], photographed[0], tmp_path, SETTINGS, Observe(held_out=0), 1)
    tried = [(attempt["attempt"], attempt["models"][0]) for attempt in facts["attempts"]]
    assert tried == [(tag, COUNT - 1) for tag in losing] + [("guided", COUNT)]
    assert counts["guided"][0] == counts["contrast"][0] > counts["thorough"][0]
    assert counts["thorough"][0] > counts["plain"][0]
    assert counts["guided"][1] != counts["contrast"][1]


@pytest.mark.slow
def test_photos_in_the_dark_connect_once_their_contrast_is_brought_out(tmp_path):
    scene, captured = captured_in(tmp_path, 0.02)
    out = tmp_path / "poses"
    out.mkdir()
    facts = make_poses(captured, scene, out, SETTINGS, Observe(held_out=0), 1)
    assert [attempt["attempt"] for attempt in facts["attempts"]] == [
        "plain",
        "thorough",
        "contrast",
    ]
    assert facts["attempts"][1]["models"] == [] and facts["registered"] == COUNT
    stand_where_they_were(load_cameras(out / "cameras.json"))


def test_enough_of_the_photos_are_registered():
    auto, half = Poses(), Poses(min_registered=0.5)
    assert sfm.wanted(23, auto) == 23 and sfm.wanted(200, auto) == 180
    assert sfm.wanted(23, half) == 11.5


@pytest.mark.slow
def test_known_cameras_without_masks_find_the_ground_they_stand_on(photographed, tmp_path):
    scene = tmp_path / "scene"
    scene.mkdir()
    (scene / "images").symlink_to(photographed[0] / "images")
    frames = []
    for v in views():
        pose = np.linalg.inv(Y_FROM_Z_UP) @ np.linalg.inv(v.world_to_camera) @ OPENCV_FROM_OPENGL
        frames.append({"file_path": f"images/{v.name}.png", "transform_matrix": pose.tolist()})
    write_json(scene / "transforms.json", {"fl_x": FOCAL, "frames": frames})

    out = tmp_path / "poses"
    out.mkdir()
    facts = make_poses(photographed[1], scene, out, SETTINGS, Observe(held_out=0), 1)
    rig = load_cameras(out / "cameras.json")
    assert facts["ground"] == "found" and abs(rig.facts["plane"]["offset"]) < 0.01
    # cameras on one side see points of that side only
    assert np.linalg.norm(rig.center - [0, 0.25, 0]) < 0.5 * rig.radius and 0.3 < rig.radius < 1.2
    for v, true in zip(rig.views, views()):
        np.testing.assert_allclose(v.world_to_camera, true.world_to_camera, atol=1e-9)
    assert len(np.load(out / "points.npz")["xyz"]) > 100


@pytest.mark.parametrize("points, registered", [(sfm.LEAST_POINTS - 1, 0), (sfm.LEAST_POINTS, 10)])
def test_a_photo_that_hardly_shows_a_point_is_not_registered(points, registered):
    """Of COLMAP's made-up models every photo shows every point."""
    options = pycolmap.SyntheticDatasetOptions()
    options.num_points3D = points
    model = pycolmap.synthesize_dataset(options)
    assert model.num_reg_images() == 10
    assert sfm.registered_images(model) == registered
    assert sfm.registered_images(None) == 0
