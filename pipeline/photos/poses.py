"""Cameras of a scene: given or by structure from motion; upright, near the origin; undistorted
photos.

Frame after this stage: right-handed, Y-up. For structure from motion the ground plane is y = 0, the
object's axis passes through the origin and its diameter is `poses.object_size` metres (1 where
unknown). Given cameras keep their own world.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from pipeline.base.config import Observe, Poses
from pipeline.base.errors import InputError
from pipeline.base.files import read_json
from pipeline.base.images import read_exr, read_png, write_exr, write_png
from pipeline.base.progress import progress
from pipeline.geometry.cameras import Y_FROM_Z_UP, Rig, View, save_cameras
from pipeline.photos.colmap_model import model_folder, names_of, read_model
from pipeline.photos.given_cameras import (
    Lens,
    check_shape,
    lens_of_colmap,
    pose_of_colmap,
    poses_of_model,
    read_transforms,
    turned_right,
)
from pipeline.photos.held_out import hold_out
from pipeline.photos.photometry import gains, match_exposure, point_brightness
from pipeline.photos.scene_files import camera_file
from pipeline.photos.sfm import HINT, on_its_side, reconstruct, sparse_points
from pipeline.photos.triangulate import triangulated
from pipeline.photos.turntable import check, light_motion

if TYPE_CHECKING:
    import pycolmap

# unit normal n, offset of the plane n.x = offset, share of inliers
Plane: TypeAlias = tuple[np.ndarray, float, float]
TRIPLES = 6000  # tries for the ground plane
MOST_TILTED = 3.0  # degrees by which the ground may be out of level in the world of given cameras
TOLERANCES = 0.004, 0.01  # of the cameras' distance, for points on the ground: fine, coarse


def positions(poses: list[np.ndarray]) -> np.ndarray:
    """Camera centres (n, 3) of world-to-camera matrices."""
    return np.stack([-p[:3, :3].T @ p[:3, 3] for p in poses])


def axes_meeting_point(poses: list[np.ndarray]) -> np.ndarray:
    """Point (3,) nearest to all optical axes in the least-squares sense."""
    centers = positions(poses)
    axes = np.stack([p[2, :3] for p in poses])
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]  # projections across each axis

    matrix = across.sum(0) + 1e-9 * np.eye(3)
    return np.linalg.solve(matrix, (across @ centers[..., None]).sum(0)[:, 0])


def mean_up(poses: list[np.ndarray]) -> np.ndarray:
    """Mean of the cameras' up directions, a unit vector (3,)."""
    up = -np.stack([p[1, :3] for p in poses]).mean(0)
    return up / np.linalg.norm(up)


def ground_plane(
    xyz: np.ndarray, centers: np.ndarray, up: np.ndarray, middle: np.ndarray, seed: int
) -> Plane | None:
    """RANSAC over the points: (unit normal n (3,), offset, share of inliers) of the plane n.x =
    offset, or None.

    A ground plane has its normal within 40 degrees of the cameras' mean up, all cameras above it,
    and at least 12 % of the nearer points, or, like white paper with little to match on it, 4 % and
    next to nothing below. The score is the share of inliers less twice the share of points well
    below. A general RANSAC counts inliers alone and finds a wall or a slope where the ground has
    little texture.

    A fine tolerance comes first, and must leave next to nothing below: seen from afar, a slope
    through a low object holds more points within the coarse one than the ground it stands on.
    """
    distance = np.median(np.linalg.norm(centers - middle, axis=1))
    near = xyz[np.linalg.norm(xyz - middle, axis=1) < 1.5 * distance]
    if len(near) < 50:
        return None

    for share in TOLERANCES:
        tolerance = share * distance
        start = _best_of_triples(near, centers, up, tolerance, np.random.default_rng(seed))
        if start is None:
            continue
        n, offset = _refit(near, *start, up, tolerance)
        inliers, below = _inliers_and_below(near, n, offset, tolerance)
        plane = n, float(offset), inliers
        if inliers >= 0.12 and below < 0.02:
            return plane

    if start is None:
        return None
    bare = inliers >= 0.04 and inliers * len(near) >= 80 and below < 0.02
    return plane if inliers >= 0.12 or bare else None


def _inliers_and_below(
    points: np.ndarray, n: np.ndarray, offset: float, tolerance: float
) -> tuple[float, float]:
    """Shares of the points (n, 3) that lie on a plane, and well below it."""
    height = points @ n - offset
    inliers = (np.abs(height) < tolerance).mean()
    return float(inliers), float((height < -3 * tolerance).mean())


def _best_of_triples(
    points: np.ndarray,
    centers: np.ndarray,
    up: np.ndarray,
    tolerance: float,
    rng: np.random.Generator,
) -> tuple[np.ndarray, float] | None:
    """Normal (3,) and offset of the best ground through three of the points, or None."""
    best = None
    best_score = 0.0
    for _ in range(TRIPLES):
        a, b, c = points[rng.choice(len(points), 3, replace=False)]
        n = np.cross(b - a, c - a)
        n = n / (np.linalg.norm(n) + 1e-12)
        n = n * np.sign(n @ up)
        if n @ up < np.cos(np.radians(40)) or (centers @ n).min() < a @ n:
            continue

        inliers, below = _inliers_and_below(points, n, a @ n, tolerance)
        score = inliers - 2.0 * below
        if score > best_score:
            best_score = score
            best = (n, a @ n)
    return best


def _refit(
    points: np.ndarray, n: np.ndarray, offset: float, up: np.ndarray, tolerance: float
) -> tuple[np.ndarray, float]:
    """Normal and offset of the plane fitted to its own inliers, five times over."""
    for _ in range(5):
        inliers = points[np.abs(points @ n - offset) < tolerance]
        center = inliers.mean(0)
        n = np.linalg.svd(inliers - center, full_matrices=False)[2][2]
        n = n * np.sign(n @ up)
        offset = center @ n
    return n, offset


def object_points(
    xyz: np.ndarray,
    poses: list[np.ndarray],
    lenses: list[Lens],
    plane: Plane | None,
    masks: list[np.ndarray] | None,
) -> np.ndarray:
    """Sparse points that belong to the object: inside the masks if there are any, else above the
    ground and near the middle of the scene.
    """
    if masks is not None:
        return _points_in_masks(xyz, poses, lenses, masks)

    middle, distance = _middle_and_distance(poses)
    if plane is not None:
        up, offset = plane[:2]
        above = xyz @ up - offset > 0.02 * distance
    else:
        up = mean_up(poses)
        above = np.ones(len(xyz), bool)

    height = (xyz - middle) @ up
    sideways = (xyz - middle) - height[:, None] * up
    central = (np.linalg.norm(sideways, axis=1) < 0.4 * distance) & (height < 0.6 * distance)
    return xyz[above & central]


def _points_in_masks(
    xyz: np.ndarray, poses: list[np.ndarray], lenses: list[Lens], masks: list[np.ndarray]
) -> np.ndarray:
    """Points inside 90 % of the masks (uint8) of the two or more views whose frame holds them."""
    inside = np.zeros(len(xyz))
    total = np.zeros(len(xyz))

    for pose, lens, mask in zip(poses, lenses, masks):
        x, y, depth = (xyz @ pose[:3, :3].T + pose[:3, 3]).T
        u = lens.fx * x / depth + lens.cx
        v = lens.fy * y / depth + lens.cy
        seen = (depth > 0) & (u >= 0) & (v >= 0) & (u < lens.width) & (v < lens.height)
        total += seen

        scale = mask.shape[1] / lens.width
        row = (v[seen] * scale).astype(int).clip(0, mask.shape[0] - 1)
        column = (u[seen] * scale).astype(int).clip(0, mask.shape[1] - 1)
        inside[seen] += mask[row, column] > 127

    return xyz[(inside >= 0.9 * total) & (total >= 2)]


def _middle_and_distance(poses: list[np.ndarray]) -> tuple[np.ndarray, float]:
    """Where the optical axes meet (3,), and the cameras' median distance from there."""
    middle = axes_meeting_point(poses)
    return middle, np.median(np.linalg.norm(positions(poses) - middle, axis=1))


def main_cluster(points: np.ndarray, bandwidth: float) -> np.ndarray:
    """The largest group of points linked by steps shorter than `bandwidth`, and groups of at least
    a third its size.
    """
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    if len(points) > 5000:  # neighbour pairs grow with the square of the density
        points = points[np.random.default_rng(0).choice(len(points), 5000, replace=False)]

    tree = cKDTree(points)
    near = tree.sparse_distance_matrix(tree, bandwidth, output_type="coo_matrix")
    label = connected_components(near.tocsr(), directed=False)[1]
    counts = np.bincount(label)
    return points[counts[label] >= counts.max() / 3]


def object_sphere(
    points: np.ndarray, poses: list[np.ndarray], plane: Plane | None
) -> tuple[np.ndarray, float, str]:
    """Centre and radius that hold the object's sparse points, and how they were found."""
    middle, distance = _middle_and_distance(poses)
    if len(points) >= 30:
        points = main_cluster(points, 0.06 * distance)
    if len(points) < 30:
        return middle, 0.35 * float(distance), "optical axes (too few object points)"

    if plane is not None:  # the object's foot on the ground belongs to it
        normal, offset = plane[:2]
        foot = points - (points @ normal - offset)[:, None] * normal
        points = np.concatenate([points, foot])

    low, high = np.percentile(points, [1, 99], axis=0)
    center = 0.5 * (low + high)
    radius = float(np.percentile(np.linalg.norm(points - center, axis=1), 99))
    return center, radius, f"{len(points)} sparse points"


def rotation_to_y(up: np.ndarray) -> np.ndarray:
    """Rotation (3, 3) that takes the unit vector `up` (3,) to +Y by the shortest way."""
    return Rotation.align_vectors([0, 1, 0], up)[0].as_matrix()


def undistort(
    image: np.ndarray, lens: Lens, interpolation: int = cv2.INTER_LINEAR
) -> tuple[np.ndarray, Lens]:
    """Pinhole version of an image, cropped by focal length so that no border shows; (image, its
    Lens).
    """
    if not any(lens.distortion):
        return image, lens

    # OpenCV's pixel centres are integers
    old = np.array([[lens.fx, 0, lens.cx - 0.5], [0, lens.fy, lens.cy - 0.5], [0, 0, 1]])
    distortion = np.array(lens.distortion)
    size = (lens.width, lens.height)
    new, _ = cv2.getOptimalNewCameraMatrix(old, distortion, size, 0.0)
    maps = cv2.initUndistortRectifyMap(old, distortion, None, new, size, cv2.CV_32FC1)

    straight = cv2.remap(image, *maps, interpolation, borderMode=cv2.BORDER_REPLICATE)
    return straight, Lens(*size, new[0, 0], new[1, 1], new[0, 2] + 0.5, new[1, 2] + 0.5)


def similarity(
    pose: np.ndarray, rotation: np.ndarray, shift: np.ndarray, scale: float
) -> np.ndarray:
    """World-to-camera for the new world x' = scale (R x) + shift."""
    out = np.eye(4)
    out[:3, :3] = pose[:3, :3] @ rotation.T
    out[:3, 3] = scale * pose[:3, 3] - out[:3, :3] @ shift
    return out


def write_views(
    capture: Path, out: Path, photos: list[dict], lenses: list[Lens], poses: list[np.ndarray]
) -> list[View]:
    """Undistort photos, their saturated pixels and masks into `out`; the views in the order of
    `photos`.
    """
    (out / "images").mkdir()
    (out / "saturated").mkdir()
    views = []

    for p, lens, pose in zip(progress(photos, "undistorted photos"), lenses, poses):
        name = p["name"]
        image, pinhole = undistort(read_exr(capture / "images" / f"{name}.exr"), lens)
        write_exr(out / "images" / f"{name}.exr", image, half=True)

        # A pixel mixed from saturated ones is a lower bound too.
        saturated, _ = undistort(read_png(capture / "saturated" / f"{name}.png"), lens)
        write_png(out / "saturated" / f"{name}.png", (saturated > 0) * np.uint8(255))

        if p["has_mask"]:
            drawn = read_png(capture / "masks" / f"{name}.png")
            mask, _ = undistort(drawn, lens, cv2.INTER_NEAREST)
            (out / "masks").mkdir(exist_ok=True)
            write_png(out / "masks" / f"{name}.png", mask)

        views.append(
            View(
                name,
                f"images/{name}.exr",
                pinhole.width,
                pinhole.height,
                pinhole.fx,
                pinhole.fy,
                pinhole.cx,
                pinhole.cy,
                pose,
                p["clip_level"],
                p["split"],
                f"saturated/{name}.png",
            )
        )
    return views


def _given_model(
    folder: Path, photos: list[dict]
) -> tuple[pycolmap.Reconstruction, dict[str, str], dict[str, tuple[Lens, np.ndarray]]]:
    """The COLMAP model in `folder`: model, its image name -> photo name, and lens and pose per
    photo name.

    Raises InputError for an unreadable model, or one that was not made from these photos.
    """
    model = read_model(folder)
    names = names_of(photos, model, folder)
    found = poses_of_model(model, names)
    sizes = {p["name"]: p["original_size"] for p in photos}
    for name, (lens, _) in found.items():
        check_shape(lens.width, lens.height, sizes[name], folder, name)
    return model, names, found


@dataclass
class Mapped:
    """COLMAP's world: the model, its image name -> photo name, lens and world-to-camera (4, 4) per
    photo name, and the model's points that a photo shows which was placed by them, per photo name.
    """

    model: pycolmap.Reconstruction
    names: dict[str, str]
    found: dict[str, tuple[Lens, np.ndarray]]
    placed: dict[str, list[int]]


def _read_model(folder: Path, photos: list[dict]) -> tuple[Mapped, dict]:
    """A given model and facts. Photos that are held out stand where the model has them."""
    model, names, found = _given_model(folder, photos)
    facts = {
        "source": "colmap",
        "reprojection_error_px": model.compute_mean_reprojection_error(),
    }
    return Mapped(model, names, found, {}), facts


def _reconstructed(
    capture: Path, photos: list[dict], settings: Poses, threads: int
) -> tuple[Mapped, dict]:
    """Structure from motion of the photos that are not held out, with the others placed by it; and
    facts.
    """
    model, names, placed, attempts = reconstruct(capture, photos, settings, threads)
    found = poses_of_model(model, names)
    for file, one in placed.items():
        found[names[file]] = lens_of_colmap(one.camera), pose_of_colmap(one.pose, file)
    for p in photos:
        if p["name"] in found and on_its_side(p, photos):  # undo `write_inputs`
            found[p["name"]] = turned_right(*found[p["name"]])
    facts = {
        "source": "sfm",
        "attempts": attempts,
        "reprojection_error_px": model.compute_mean_reprojection_error(),
    }
    sights = {names[file]: one.points for file, one in placed.items()}
    return Mapped(model, names, found, sights), facts


def upright(
    mapped: Mapped,
    photos: list[dict],
    capture: Path,
    settings: Poses,
) -> tuple[list[dict], list[Lens], list[np.ndarray], np.ndarray, float, dict, dict]:
    """Turn, shift and scale a COLMAP world so that +Y is up and the object lies at the origin:
    photos kept, lenses, poses, centre and radius of the object's sphere, sparse points, facts.
    Photos that are held out are moved along and say nothing.
    """
    found = mapped.found
    kept = [p for p in photos if p["name"] in found]
    lenses = [found[p["name"]][0] for p in kept]
    poses = [found[p["name"]][1] for p in kept]
    xyz, rgb, error, offsets, views = sparse_points(mapped.model, *_sightings(mapped, kept))

    told = [p for p in kept if p["split"] == "fit"]
    lenses_told = [found[p["name"]][0] for p in told]
    poses_told = [found[p["name"]][1] for p in told]
    up = mean_up(poses_told)
    middle = axes_meeting_point(poses_told)
    plane = ground_plane(xyz, positions(poses_told), up, middle, settings.seed)
    masks = None
    if all(p["has_mask"] for p in told):
        masks = [read_png(capture / "masks" / f"{p['name']}.png") for p in told]
    points = object_points(xyz, poses_told, lenses_told, plane, masks)
    center, radius, how = object_sphere(points, poses_told, None if masks is not None else plane)

    rotation, shift, scale = _to_library_frame(plane, up, center, radius, settings)
    moved = [similarity(p, rotation, shift, scale) for p in poses]
    facts = _frame_facts(plane, how, rotation, shift, scale)
    cloud = {
        "xyz": scale * xyz @ rotation.T + shift,
        "rgb": rgb,
        "error": error,
        "offsets": offsets,
        "views": views,
    }
    center = scale * rotation @ center + shift
    return kept, lenses, moved, center, 1.25 * scale * radius, cloud, facts


def _sightings(mapped: Mapped, kept: list[dict]) -> tuple[dict[int, int], dict[int, list[int]]]:
    """The model's image number -> index in `kept`, of photos that are not held out; and number of a
    point -> indices of held-out photos that show it.
    """
    index = {p["name"]: k for k, p in enumerate(kept)}
    order = {}
    others: dict[int, list[int]] = {}
    for image in mapped.model.images.values():
        at = index.get(mapped.names.get(image.name, ""))
        if at is None:
            continue
        if kept[at]["split"] == "fit":
            order[image.image_id] = at
            continue
        for point in image.points2D:
            if point.has_point3D():
                others.setdefault(point.point3D_id, []).append(at)
    for name, points in mapped.placed.items():
        for number in points:
            others.setdefault(number, []).append(index[name])
    return order, others


def _to_library_frame(
    plane: Plane | None, up: np.ndarray, center: np.ndarray, radius: float, settings: Poses
) -> tuple[np.ndarray, np.ndarray, float]:
    """Rotation, shift and scale of x' = scale (R x) + shift: the ground becomes y = 0, the object
    has the wanted size and stands above the origin.
    """
    normal = plane[0] if plane is not None else up
    rotation = rotation_to_y(normal) if settings.up == "auto" else np.eye(3)
    scale = (settings.object_size or 1.0) / (2 * radius)

    shift = -scale * (rotation @ center)
    if settings.up == "auto":
        ground = plane[1] if plane is not None else normal @ center - radius
        shift[1] = -scale * ground
    return rotation, shift, scale


def _frame_facts(
    plane: Plane | None, how: str, rotation: np.ndarray, shift: np.ndarray, scale: float
) -> dict:
    """What cameras.json says of the change of frame, and of `how` the object was found."""
    world = np.eye(4)
    world[:3, :3] = scale * rotation
    world[:3, 3] = shift

    turned = None
    if plane is not None:
        normal, offset, inlier_share = plane
        turned = {
            "normal": rotation @ normal,
            "offset": scale * offset + shift @ (rotation @ normal),
            "inlier_share": inlier_share,
        }
    return {
        "up": "ground plane" if plane is not None else "mean camera up (no ground plane found)",
        "object_found_by": how,
        "plane": turned,
        "world": world,
    }


def _given(
    file: Path, scene: Path, photos: list[dict]
) -> tuple[list[dict], list[Lens], list[np.ndarray], np.ndarray, float, dict, dict]:
    """As `upright`, for cameras from transforms files, which keep their own world."""
    sizes = {p["name"]: tuple(p["original_size"]) for p in photos}
    found = read_transforms(file, scene, sizes)
    if (scene / "transforms_test.json").exists():
        found |= read_transforms(scene / "transforms_test.json", scene, sizes)

    kept = [p for p in photos if p["name"] in found]
    lenses, poses = zip(*(found[p["name"]] for p in kept))
    told = [found[p["name"]][1] for p in kept if p["split"] == "fit"]
    center, distance = _middle_and_distance(told)
    points = {
        "xyz": np.zeros((0, 3)),
        "rgb": np.zeros((0, 3), np.uint8),
        "error": np.zeros(0),
        "offsets": np.zeros(1, int),
        "views": np.zeros(0, int),
    }
    facts = {
        "source": "transforms.json",
        "up": "the cameras' own world",
        "plane": None,
        "world": Y_FROM_Z_UP,
    }
    return kept, lenses, poses, center, 0.5 * float(distance), points, facts


def ground_of_given(
    xyz: np.ndarray, views: list[View], center: np.ndarray, radius: float, settings: Poses
) -> tuple[np.ndarray, float, dict]:
    """The ground in the world of given cameras, which is y = height there or not at all, and the
    object's sphere above it: centre, radius and facts. Without such a ground the sphere stays.
    """
    told = [v.world_to_camera for v in views if v.split == "fit"]
    middle = axes_meeting_point(told)
    up = np.array([0.0, 1.0, 0.0])
    plane = ground_plane(xyz, positions(told), up, middle, settings.seed)
    if plane is None:
        return center, radius, {"ground": "no ground plane among the matched points"}

    normal, offset, share = plane
    tilt = float(np.degrees(np.arccos(np.clip(normal @ up, -1, 1))))
    if tilt > MOST_TILTED:
        return center, radius, {"ground": f"tilted by {tilt:.1f} degrees against the cameras' up"}

    center, radius, how = object_sphere(object_points(xyz, told, [], plane, None), told, plane)
    height = (offset - normal[0] * center[0] - normal[2] * center[2]) / normal[1]
    facts = {"normal": up, "offset": float(height), "inlier_share": share}
    return center, 1.25 * radius, {"plane": facts, "ground": "found", "object_found_by": how}


def _photometry(
    views: list[View],
    out: Path,
    points: dict,
    sphere: tuple[np.ndarray, float],
    scene: Path,
    settings: Poses,
) -> tuple[list[View], dict]:
    """What matched points say of light that moves with the camera (facts, `warnings` among them, or
    InputError), and of the photos' gains, which are divided out of the pictures under `out`. Views
    and facts. sphere: the object's centre and radius.
    """
    brightness = point_brightness(views, out, points)
    fit = np.array([v.split == "fit" for v in views])
    stops = gains(brightness, fit)
    green = brightness[fit][..., 1] - stops[fit, 1, None]
    told = [v for v in views if v.split == "fit"]
    motion = light_motion(told, green, points["xyz"], *sphere)
    accept = settings.moving_light == "accept"
    facts: dict = {
        "light_motion": motion.facts(),
        "warnings": check(motion, str(scene), accept),
    }
    if settings.match_exposure:
        views, matched = match_exposure(views, out, stops)
        facts |= matched
    return views, facts


def make_poses(
    capture: Path, scene: Path, out: Path, settings: Poses, held_out: Observe, threads: int
) -> dict:
    """Write cameras.json, images/, masks/ and points.npz into `out`; returns metrics. held_out:
    says which photos are kept for scoring (`hold_out`), of which no stage learns anything.

    Raises InputError when cameras are unusable or photos do not connect.
    """
    photos = read_json(capture / "photos.json")["photos"]
    file = camera_file(scene)
    folder = model_folder(scene)
    if file:
        photos = hold_out(photos, held_out)
        kept, lenses, poses, center, radius, points, facts = _given(file, scene, photos)
    else:
        if folder is not None:
            mapped, facts = _read_model(folder, photos)
            known = hold_out([p for p in photos if p["name"] in mapped.found], held_out)
            photos = known + [p for p in photos if p["name"] not in mapped.found]
        else:
            photos = hold_out(photos, held_out)
            mapped, facts = _reconstructed(capture, photos, settings, threads)
        kept, lenses, poses, center, radius, points, more = upright(
            mapped, photos, capture, settings
        )
        facts |= more
    if sum(p["split"] == "fit" for p in kept) < 3:
        raise InputError(f"only {len(kept)} photos have a camera", scene, HINT)

    lenses = [lens.at(p["width"], p["height"]) for lens, p in zip(lenses, kept)]
    with_camera = {p["name"] for p in kept}
    facts["unregistered"] = [p["name"] for p in photos if p["name"] not in with_camera]
    views = write_views(capture, out, kept, lenses, poses)
    if file and not any(p["has_mask"] for p in kept):
        points = triangulated(views, out, settings, threads)
        center, radius, ground = ground_of_given(points["xyz"], views, center, radius, settings)
        facts |= ground
    elif len(points["xyz"]):
        views, seen = _photometry(views, out, points, (center, radius), scene, settings)
        facts |= seen

    np.savez_compressed(out / "points.npz", **points)
    save_cameras(out / "cameras.json", Rig(views, center, radius, facts["source"], facts))
    return {
        "registered": len(kept),
        "held_out": [p["name"] for p in kept if p["split"] == "test"],
        "photos": len(photos),
        "points": len(points["xyz"]),
        "radius": radius,
    } | facts
