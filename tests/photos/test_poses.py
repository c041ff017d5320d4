import json

import cv2
import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

from pipeline.base.config import Observe, Poses
from pipeline.base.errors import InputError
from pipeline.base.images import write_exr
from pipeline.geometry.cameras import Rig, View, load_cameras, save_cameras
from pipeline.photos.given_cameras import Lens, read_transforms, turned_right
from pipeline.photos.given_world import ground_of_given
from pipeline.photos.ground_plane import NoGround, ground_plane
from pipeline.photos.library_frame import rotation_to_y, similarity
from pipeline.photos.scene_files import named_frames
from pipeline.photos.sfm import write_inputs
from pipeline.photos.undistort import undistort
from pipeline.photos.viewpoints import axes_meeting_point
from tests.seeds import numpy_rng

ALL = Observe(held_out=0)  # every photo is used


def test_cameras_survive_the_disk(tmp_path, ring):
    save_cameras(
        tmp_path / "c.json", Rig(ring(3), np.array([1.0, 2, 3]), 0.5, "sfm", {"plane": None})
    )
    rig = load_cameras(tmp_path / "c.json")
    assert rig.views[1].name == "v1" and np.allclose(rig.center, [1, 2, 3])
    assert np.allclose(rig.views[2].world_to_camera, ring(3)[2].world_to_camera)


def test_rays_and_projection_are_inverse(ring):
    view = ring(5)[3]
    uv = numpy_rng(0).uniform(0, 64, (50, 2))
    o, d = view.rays(uv)
    back, depth = view.project(o + 2.5 * d)
    assert np.allclose(back, uv) and (depth > 0).all() and np.allclose(np.linalg.norm(d, axis=1), 1)


def test_transforms_put_a_point_where_blender_would(tmp_path):
    """A camera on +Y (Z-up world) looking at the origin: +Z is up in the picture, +X to its
    left.
    """
    matrix = np.array([[-1, 0, 0, 0], [0, 0, 1, 3.0], [0, 1, 0, 0], [0, 0, 0, 1.0]])
    (tmp_path / "transforms.json").write_text(
        json.dumps(
            {
                "camera_angle_x": 2 * np.arctan(0.5),
                "frames": [{"file_path": "./train/r_0", "transform_matrix": matrix.tolist()}],
            }
        )
    )
    lens, pose = read_transforms(tmp_path / "transforms.json", tmp_path, {"train_r_0": (100, 80)})[
        "train_r_0"
    ]
    assert np.isclose(lens.fx, 100) and lens.cx == 50 and lens.cy == 40
    view = View("v", "", 100, 80, lens.fx, lens.fy, lens.cx, lens.cy, pose)
    up, _ = view.project(np.array([0.0, 0.1, 0.0]))  # library frame: Y-up; Blender's +Z
    left, _ = view.project(np.array([0.1, 0.0, 0.0]))
    assert (
        np.isclose(up[0], 50)
        and up[1] < 40
        and left[0] < 50
        and np.allclose(view.position, [0, 0, -3])
    )


def test_frame_of_a_photo_that_capture_has_left_out_is_named(tmp_path):
    file = tmp_path / "transforms.json"
    frames = [{"file_path": "images/a.png", "transform_matrix": np.eye(4).tolist()}]
    file.write_text(json.dumps({"camera_angle_x": 0.7, "frames": frames}))
    with pytest.raises(InputError, match="'images/a.png' was not captured"):
        read_transforms(file, tmp_path, {"b": (8, 8)})


def test_frame_without_a_matrix_is_named(tmp_path):
    (tmp_path / "t.json").write_text(
        json.dumps(
            {"camera_angle_x": 1.0, "frames": [{"file_path": "a.png", "transform_matrix": [[1]]}]}
        )
    )
    with pytest.raises(InputError, match="a.png"):
        read_transforms(tmp_path / "t.json", tmp_path, {"a": (10, 10)})


def test_colmap_model_passes_through(tmp_path):
    import pycolmap

    from pipeline.photos.given_cameras import poses_of_model

    model = pycolmap.Reconstruction()
    camera = pycolmap.Camera(
        model="SIMPLE_RADIAL", width=100, height=80, params=[90, 50, 40, 0.01], camera_id=1
    )
    model.add_camera_with_trivial_rig(camera)
    image = pycolmap.Image(name="a.jpg", camera_id=1, image_id=1)
    model.add_image_with_trivial_frame(
        image, pycolmap.Rigid3d(pycolmap.Rotation3d(), np.array([0.1, 0.2, 3.0]))
    )
    lens, pose = poses_of_model(model, {"a.jpg": "a"})["a"]
    assert lens == Lens(100, 80, 90, 90, 50, 40, (0.01, 0.0, 0.0, 0.0)) and np.allclose(
        pose[:3, 3], [0.1, 0.2, 3.0]
    )


def test_ground_is_found_and_turned_level(ring):
    rng = numpy_rng(0)
    tilt = rotation_to_y(np.array([0.2, 0.9, 0.1]) / np.linalg.norm([0.2, 0.9, 0.1])).T
    flat = np.concatenate(
        [
            np.stack([rng.uniform(-1, 1, 400), np.zeros(400) - 0.4, rng.uniform(-1, 1, 400)], 1),
            rng.uniform(-0.3, 0.3, (300, 3)) + [0, -0.1, 0],
        ]
    )
    centers = np.stack([v.position for v in ring(8, elevation=40) if v.position[1] > 0])
    plane = ground_plane(flat @ tilt.T, centers @ tilt.T, tilt @ [0, 1, 0], np.zeros(3), 0)
    assert (
        np.degrees(np.arccos(plane.normal @ tilt @ [0, 1, 0])) < 0.5
        and abs(plane.offset + 0.4) < 0.01
        and plane.inlier_share > 0.4
    )


def test_any_direction_is_turned_up():
    """+Y itself, its opposite and what is near it too."""
    random = numpy_rng(0).normal(size=(20, 3))
    near_down = [[d, -1, 0.5 * d] for d in (0, 1e-6, 1e-3)]
    for up in [*random, *near_down, [0, 1, 0]]:
        up = np.array(up, float) / np.linalg.norm(up)
        rotation = rotation_to_y(up)
        assert np.allclose(rotation @ up, [0, 1, 0], atol=1e-12)
        assert np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
        assert np.isclose(np.linalg.det(rotation), 1)
        # the shortest way: by the angle between the two, and no further
        assert np.isclose(np.trace(rotation), 1 + 2 * up[1], atol=1e-9)


def test_no_ground_in_a_cloud_of_points(ring):
    cloud = numpy_rng(0).normal(size=(500, 3))
    centers = np.stack([v.position for v in ring(8)])
    found = ground_plane(cloud, centers, np.array([0, 1.0, 0]), np.zeros(3), 0)
    assert isinstance(found, NoGround) and "500 matched points" in found.why


def test_why_there_is_no_ground(ring):
    """Too few points, none of the planes below all cameras, or too little on the best one: each has
    a cure of its own.
    """
    up = np.array([0, 1.0, 0])
    below = np.stack([v.position for v in ring(8)])
    few = numpy_rng(0).normal(size=(20, 3))
    found = ground_plane(few, below, up, np.zeros(3), 0)
    assert isinstance(found, NoGround) and "only 20 points" in found.why
    assert "texture" in found.cure

    above = np.abs(numpy_rng(0).normal(size=(200, 3))) * 0.1 + [0, 3.0, 0]
    found = ground_plane(above, below, up, np.array([0, 3.0, 0]), 0)
    assert isinstance(found, NoGround) and "below all cameras" in found.why
    assert "from above" in found.cure

    over = numpy_rng(1).uniform([-0.4, -0.3, -0.4], [0.4, 0.5, 0.4], (400, 3))
    over[:20, 1] = -0.4  # 5 % on a ground, fewer than 80
    above_it = np.stack([v.position for v in ring(16, elevation=40) if v.position[1] > 0])
    found = ground_plane(over, above_it, up, np.zeros(3), 0)
    assert isinstance(found, NoGround) and "the best plane holds" in found.why
    assert "level table" in found.cure


@pytest.mark.parametrize("tilt, part", [(0, "found"), (20, "tilted by 20")])
def test_a_ground_in_the_world_of_given_cameras_is_level(ring, tilt, part):
    """Seen by cameras that stand upright over it, or tilted with it."""
    turn = np.eye(4)
    turn[:3, :3] = Rotation.from_euler("x", tilt, degrees=True).as_matrix()
    views = [v for v in ring(16, elevation=40) if v.position[1] > 0]
    for v in views:
        v.world_to_camera = v.world_to_camera @ turn.T
    x, z = numpy_rng(0).uniform(-1, 1, (2, 600))
    ground = np.stack([x, np.full(600, -0.4), z], 1) @ turn[:3, :3].T
    _, _, facts = ground_of_given(ground, views, np.zeros(3), 1.0)
    assert part in facts["ground"]
    assert (facts.get("no_ground", {}).get("why") == facts["ground"]) == (tilt > 0)


def test_axes_meet_at_the_target(ring):
    assert np.allclose(axes_meeting_point([v.world_to_camera for v in ring(6)]), 0, atol=1e-6)


def test_similarity_moves_points_and_cameras_together(ring):
    view = ring(4)[1]
    rotation, shift, scale = rotation_to_y(np.array([0.6, 0.8, 0])), np.array([0.3, -1, 2]), 2.5
    moved = View(
        "m",
        "",
        64,
        64,
        view.fx,
        view.fy,
        view.cx,
        view.cy,
        similarity(view.world_to_camera, rotation, shift, scale),
    )
    point = np.array([0.2, 0.1, -0.3])
    assert np.allclose(moved.project(scale * rotation @ point + shift)[0], view.project(point)[0])


def test_undistorted_straight_lines():
    """Distort a grid of points by hand; undistorting must bring a dot back to where the pinhole
    sees it.
    """
    lens = Lens(200, 160, 180, 180, 100, 80, (-0.2, 0.0, 0.0, 0.0))
    x, y = 0.35, 0.25
    r2 = x * x + y * y
    u, v = 180 * x * (1 - 0.2 * r2) + 100, 180 * y * (1 - 0.2 * r2) + 80
    rows, columns = np.mgrid[0:160, 0:200]
    image = np.exp(-((columns + 0.5 - u) ** 2 + (rows + 0.5 - v) ** 2) / 8).astype(np.float32)
    straight, new = undistort(image, lens)
    weight = straight / straight.sum()
    center = (weight * (columns + 0.5)).sum(), (weight * (rows + 0.5)).sum()
    assert np.allclose(center, (new.fx * x + new.cx, new.fy * y + new.cy), atol=0.3)


@pytest.mark.parametrize(
    "more, fact",
    [
        ({"camera_model": "OPENCV_FISHEYE"}, "fisheye"),
        ({"k3": 0.1}, "k3"),
        ({"w": 80, "h": 100}, "not the same shape"),
    ],
)
def test_cameras_that_would_be_misread_are_refused(tmp_path, more, fact):
    frames = [{"file_path": "a.png", "transform_matrix": np.eye(4).tolist()}]
    (tmp_path / "t.json").write_text(json.dumps({"camera_angle_x": 1.0, "frames": frames} | more))
    with pytest.raises(InputError, match=fact):
        read_transforms(tmp_path / "t.json", tmp_path, {"a": (100, 80)})


def _captured(tmp_path, pictures):
    from pipeline.base.config import Capture
    from pipeline.photos.capture import capture

    (tmp_path / "scene" / "images").mkdir(parents=True)
    for k, picture in enumerate(pictures):
        Image.fromarray(picture).save(tmp_path / "scene" / "images" / f"{k}.png")
    (tmp_path / "capture").mkdir()
    capture(tmp_path / "scene", tmp_path / "capture", Capture(leave_out="none"))
    (tmp_path / "poses").mkdir()
    return tmp_path / "capture", tmp_path / "scene", tmp_path / "poses"


@pytest.mark.parametrize("kind", ["blank", "unrelated"])
def test_photos_that_do_not_connect_are_refused(tmp_path, kind):
    from pipeline.photos.poses import make_poses

    rng = numpy_rng(3)
    pictures = [
        np.full((90, 120, 3), 120, np.uint8)
        if kind == "blank"
        else np.kron(rng.integers(0, 255, (15, 20, 3)), np.ones((6, 6, 1))).astype(np.uint8)
        for _ in range(4)
    ]
    with pytest.raises(InputError, match="only 0 of 4 photos.*\n.*overlap"):
        make_poses(*_captured(tmp_path, pictures), Poses(max_size=200, features=500), ALL, 2)


def _model(folder, names, ring):
    """A COLMAP model of exact pinhole cameras (no points) on disk, in its usual y-down world."""
    import pycolmap

    model = pycolmap.Reconstruction()
    model.add_camera_with_trivial_rig(
        pycolmap.Camera(model="PINHOLE", width=64, height=64, params=[90, 90, 32, 32], camera_id=1)
    )
    turn = np.diag([1.0, -1, -1])
    for k, (name, view) in enumerate(zip(names, ring(len(names)))):
        pose = pycolmap.Rigid3d(
            pycolmap.Rotation3d(view.world_to_camera[:3, :3] @ turn.T), view.world_to_camera[:3, 3]
        )
        model.add_image_with_trivial_frame(
            pycolmap.Image(name=name, camera_id=1, image_id=k + 1), pose
        )
    folder.mkdir(parents=True)
    model.write(folder)


def test_colmap_folder_without_points_is_turned_upright(tmp_path, ring):
    from pipeline.photos.poses import make_poses

    noise = numpy_rng(0).integers(0, 255, (6, 64, 64, 3)).astype(np.uint8)
    capture, scene, out = _captured(tmp_path, list(noise))
    _model(scene / "sparse" / "0", [f"{k}.png" for k in range(6)], ring)
    metrics = make_poses(capture, scene, out, Poses(), ALL, 2)
    rig = load_cameras(out / "cameras.json")
    assert (
        metrics["source"] == "colmap"
        and metrics["registered"] == 6
        and "mean camera up" in metrics["up"]
    )
    ups = np.stack([-v.world_to_camera[1, :3] for v in rig.views])
    assert (ups[:, 1] > 0.8).all()
    for v in rig.views:  # every optical axis still passes the object's centre
        uv, depth = v.project(rig.center)
        assert np.allclose(uv, 32, atol=1e-3) and depth > 0


def test_model_with_images_that_are_not_there_is_refused(tmp_path, ring):
    from pipeline.photos.poses import make_poses

    capture, scene, out = _captured(
        tmp_path, [np.zeros((64, 64, 3), np.uint8) + k for k in range(4)]
    )
    _model(scene / "sparse" / "0", [f"{k}.png" for k in range(3)] + ["lost.png"], ring)
    with pytest.raises(InputError, match="lost.png"):
        make_poses(capture, scene, out, Poses(), ALL, 2)


def test_a_lens_turned_by_a_quarter_sees_the_same_points_turned(ring):
    """A point at column x, row y of a photo lies at column h - y, row x after it was turned
    clockwise.
    """
    view = ring(5)[2]
    lens = Lens(90, 64, 80.0, 82.0, 44.0, 33.0, (-0.2, 0.05, 0.01, -0.02))
    turned, pose = turned_right(lens, view.world_to_camera)
    points = numpy_rng(0).uniform(-0.4, 0.4, (50, 3))
    before = _distorted(lens, view.world_to_camera, points)
    after = _distorted(turned, pose, points)
    np.testing.assert_allclose(after, np.stack([64 - before[:, 1], before[:, 0]], 1), atol=1e-9)
    assert (turned.width, turned.height) == (64, 90)


def _distorted(lens, pose, points) -> np.ndarray:
    """Pixels (n, 2) by OpenCV's own model."""
    import cv2

    camera = np.array([[lens.fx, 0, lens.cx], [0, lens.fy, lens.cy], [0, 0, 1]])
    rotation = cv2.Rodrigues(pose[:3, :3])[0]
    return cv2.projectPoints(points, rotation, pose[:3, 3], camera, np.array(lens.distortion))[0][
        :, 0
    ]


@pytest.mark.parametrize("setting, cameras", [("auto", 2), ("single", 1), ("per_image", 5)])
def test_portraits_and_landscapes_of_one_camera_share_it(tmp_path, setting, cameras):
    """Three landscapes and a portrait of one camera, and one of a longer lens, as COLMAP gets
    them: of one size, the portrait lying on its left side.
    """
    from pipeline.base.config import Capture
    from pipeline.photos.capture import capture
    from tests.photos.files import PICTURE

    (tmp_path / "scene" / "images").mkdir(parents=True)
    upright = np.rot90(PICTURE, 3)
    for k, picture in enumerate([PICTURE, PICTURE, upright, PICTURE, PICTURE]):
        exif = Image.Exif()
        exif.get_ifd(0x8769)[0x920A] = 50.0 if k == 4 else 35.0
        Image.fromarray(picture).save(
            tmp_path / "scene" / "images" / f"{k}.jpg", exif=exif, quality=98, subsampling=0
        )
    (tmp_path / "capture").mkdir()
    capture(tmp_path / "scene", tmp_path / "capture", Capture(leave_out="none"))
    photos = json.loads((tmp_path / "capture" / "photos.json").read_text())["photos"]
    (tmp_path / "colmap").mkdir()
    names, count = write_inputs(
        tmp_path / "capture", photos, tmp_path / "colmap", Poses(camera=setting)
    )

    assert count == cameras == len({file.split("/")[0] for file in names})
    assert sorted(names.values()) == ["0", "1", "2", "3", "4"]
    for file in names:
        with Image.open(tmp_path / "colmap" / file) as image:
            np.testing.assert_allclose(
                np.asarray(image)[12::24, 16::32], PICTURE[12::24, 16::32], atol=6
            )


def test_photos_are_matched_as_they_were_exposed(tmp_path):
    """A short exposure over its gain is bright: at the scene's white it would be all white."""
    (tmp_path / "images").mkdir()
    (tmp_path / "matched").mkdir()
    shown = numpy_rng(0).uniform(0.2, 0.9, (32, 48, 3)).astype(np.float32)
    shown = cv2.GaussianBlur(shown, (0, 0), 3)
    photos = []
    for k, gain in enumerate((1.0, 1 / 16)):
        write_exr(tmp_path / "images" / f"{k}.exr", shown / gain, half=True)
        photos.append({"name": str(k), "gain": gain, "width": 48, "height": 32})
    names, _ = write_inputs(tmp_path, photos, tmp_path / "matched", Poses())
    one, two = (np.asarray(Image.open(tmp_path / "matched" / file)).astype(int) for file in names)
    assert np.ptp(one) > 10 and np.array_equal(one, two)


def test_saturated_pixels_reach_the_poses(tmp_path, ring):
    """Through undistortion, and by their own picture: their mean is far below the clip level."""
    from pipeline.base.images import read_exr, read_png
    from pipeline.photos.poses import make_poses
    from pipeline.photos.saturation import saturated

    noise = numpy_rng(0).integers(0, 200, (6, 64, 64, 3)).astype(np.uint8)
    noise[:, 20, 30, 1] = 255
    capture, scene, out = _captured(tmp_path, list(noise))
    _model(scene / "sparse" / "0", [f"{k}.png" for k in range(6)], ring)
    make_poses(capture, scene, out, Poses(), ALL, 2)
    view = load_cameras(out / "cameras.json").views[0]
    assert np.argwhere(read_png(out / view.saturated)).tolist() == [[20, 30, 1]]
    photo = read_exr(out / view.image)
    assert np.argwhere(saturated(out, view, 0.01 * photo)).tolist() == [[20, 30, 1]]


def test_a_list_longer_than_its_file_is_refused_before_it_is_read(tmp_path):
    from benchmarks.corpus.models import write_binary
    from benchmarks.corpus.project import Project
    from pipeline.photos.colmap_model import read_model

    project = Project(tmp_path / "p")
    project.make()
    folder = write_binary(project)
    assert read_model(folder).num_images() > 0
    good = (folder / "images.bin").read_bytes()
    counted = good.find(b"p0.png\0") + len(b"p0.png\0")  # of the first image's keypoints
    (folder / "images.bin").write_bytes(good[:counted] + b"\xff\xff\xff\x0f" + good[counted + 4 :])
    with pytest.raises(InputError, match=r"images\.bin is damaged"):
        read_model(folder)


def test_a_model_with_a_name_that_is_no_text_is_refused(tmp_path):
    from benchmarks.corpus.models import write_binary
    from benchmarks.corpus.project import Project
    from pipeline.photos.colmap_model import read_model

    project = Project(tmp_path / "p")
    project.make()
    folder = write_binary(project)
    good = (folder / "images.bin").read_bytes()
    assert b"p0.png" in good
    (folder / "images.bin").write_bytes(good.replace(b"p0.png", b"p\xae.png"))
    with pytest.raises(InputError, match=r"the name of image \d+ is damaged"):
        read_model(folder)


def test_a_frame_with_a_name_that_no_disk_takes_is_missing(tmp_path):
    for name in ("x" * 300, "x" * 300 + ".png"):
        frames = [{"file_path": f"images/{name}", "transform_matrix": np.eye(4).tolist()}]
        file = tmp_path / "transforms.json"
        file.write_text(json.dumps({"fl_x": 10, "frames": frames}))
        with pytest.raises(InputError, match="1 of 1 frames name photos that are not there"):
            named_frames(tmp_path, file)
