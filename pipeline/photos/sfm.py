"""Structure from motion with COLMAP on the CPU: SIFT, matching, incremental mapping, and a last
adjustment that loose matches hardly weigh in (adjustment.py).

Too few photos registered: more thorough attempts, one after the other (ATTEMPTS). The largest model
is kept.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from PIL import Image

from pipeline.base.config import Observe, Poses
from pipeline.base.errors import InputError
from pipeline.base.images import read_exr, to_srgb8
from pipeline.base.progress import progress
from pipeline.geometry.cameras import View
from pipeline.photos.adjustment import adjust
from pipeline.photos.contrast import brought_out
from pipeline.photos.held_out import Placed, hold_out, matches_between, place, without_matches

if TYPE_CHECKING:
    import pycolmap

HINT = (
    "photograph with about 80 % overlap, all the way round, on a textured ground, "
    "without zooming or moving the object"
)
SEED = 0  # of all tries of the poses stage
# until one registers enough: as configured; more features, of affine shapes and pooled sizes; the
# same in photos whose contrast is brought out; the features of the better of these two matched anew
# along the geometry that their first matches have shown, which takes ten times as long and finds
# loose matches too; those matches, by global mapping
ATTEMPTS = "plain", "thorough", "contrast", "guided", "global"
RICHER = "contrast", "thorough"  # attempts with more features; the first where both do as well
AS_EXPOSED, BROUGHT_OUT = "images", "brought-out"  # folders of copies for COLMAP
EVERY_PHOTO = 1 << 20  # that models may share
# photos, none of which can be spared: where one is lost the cameras of the others are shaky too
FEW = 30
ENOUGH = 0.9  # of more photos, enough
# points of the model that a photo shows at least, to be registered: half of what COLMAP's
# incremental mapping asks before it places one. Global mapping asks nothing: of a vase on a black
# table at night it placed 32 photos by 100 points in all, none of them where it was
LEAST_POINTS = 15
EXIF_IFD = 0x8769
FOCAL_35MM = 0xA405


def camera_of(photo: dict, settings: Poses, number: int) -> tuple:
    """Key of the camera that took a photo: photos with equal keys share focal length and
    distortion. A camera turned on its side is the same camera.
    """
    if settings.camera == "single":
        return ()
    if settings.camera == "per_image":
        return (number,)
    sides = sorted((photo["width"], photo["height"]))
    return (*sides, photo.get("focal_35mm"), photo.get("focal_mm"), photo.get("model"))


def on_its_side(photo: dict, photos: list[dict]) -> bool:
    """Whether a photo is given to COLMAP turned by a quarter: portraits, where landscapes of the
    same size are more, and the other way round. One camera in COLMAP has one picture size.
    """
    size = (photo["width"], photo["height"])
    same = sum((p["width"], p["height"]) == size for p in photos)
    turned = sum((p["height"], p["width"]) == size for p in photos)
    return same < turned or (same == turned and size[0] < size[1])


def write_inputs(
    capture: Path, photos: list[dict], folder: Path, settings: Poses, as_exposed: bool = True
) -> tuple[dict[str, str], int]:
    """8-bit copies for COLMAP with plain ASCII names, a folder for each camera; returns file name
    -> photo name, and how many cameras there are. Photos `on_its_side` are turned to the left.
    Those that are not `as_exposed` have their contrast brought out (contrast.py).
    """
    names = {}
    folders: dict[tuple, str] = {}

    for k, p in enumerate(progress(photos, "photos for matching")):
        # as it was exposed: what is bright in a short exposure is white at the scene's
        exposed = read_exr(capture / "images" / f"{p['name']}.exr") * np.float32(p["gain"])
        image = Image.fromarray(to_srgb8(exposed))
        image.thumbnail((settings.max_size, settings.max_size), Image.Resampling.LANCZOS)
        if not as_exposed:
            image = Image.fromarray(brought_out(np.asarray(image)))
        if on_its_side(p, photos):
            image = image.transpose(Image.Transpose.ROTATE_90)

        tags = Image.Exif()
        if p.get("focal_35mm"):
            tags.get_ifd(EXIF_IFD)[FOCAL_35MM] = int(round(p["focal_35mm"]))
        camera = folders.setdefault(camera_of(p, settings, k), f"{len(folders):05d}")
        (folder / camera).mkdir(exist_ok=True)
        file = f"{camera}/{k:05d}.jpg"
        image.save(folder / file, quality=97, subsampling=0, exif=tags)
        names[file] = p["name"]

    return names, len(folders)


def _say(step: str, tag: str) -> None:
    """Announce a step of COLMAP, which shows no progress of its own."""
    print(f"{step} ({tag})", file=sys.stderr, flush=True)


def write_matched(picture: Path, view: View, out: Path, most: int) -> View:
    """An 8-bit copy, its long side at most `most` pixels, of a picture without distortion; the view
    at its size.
    """
    image = Image.fromarray(to_srgb8(read_exr(picture)))
    image.thumbnail((most, most), Image.Resampling.LANCZOS)
    image.save(out, quality=97, subsampling=0)
    return view.at_size(*image.size)


def extract_each(database: Path, images: Path, settings: Poses, threads: int) -> None:
    """Features of pictures, each with a camera of its own, into the database."""
    import pycolmap

    _say("features", "given cameras")
    _extract(database, images, settings, False, threads, pycolmap.CameraMode.PER_IMAGE)


def match_given(database: Path, count: int, settings: Poses, threads: int) -> None:
    """Matches of the database's `count` pictures, which are one sequence."""
    _say("matching", "given cameras")
    exhaustive = settings.matching == "exhaustive" or settings.matching == "auto" and count <= 60
    _match(database, exhaustive, False, threads)


def _extract(
    database: Path,
    images: Path,
    settings: Poses,
    thorough: bool,
    threads: int,
    cameras: pycolmap.CameraMode,
) -> None:
    """SIFT features of all photos into the database."""
    import pycolmap

    options = pycolmap.FeatureExtractionOptions()
    options.num_threads = threads
    options.use_gpu = False
    options.max_image_size = settings.max_size
    options.sift.max_num_features = max(8192, settings.features) if thorough else settings.features
    options.sift.estimate_affine_shape = thorough
    options.sift.domain_size_pooling = thorough
    reader = pycolmap.ImageReaderOptions()
    reader.camera_model = "SIMPLE_RADIAL"

    pycolmap.extract_features(
        database,
        images,
        reader_options=reader,
        extraction_options=options,
        camera_mode=cameras,
    )


def _match(database: Path, exhaustive: bool, guided: bool, threads: int) -> None:
    """Match the features of all pairs of photos, or of neighbours in their sequence."""
    import pycolmap

    options = pycolmap.FeatureMatchingOptions()
    options.num_threads = threads
    options.use_gpu = False
    options.guided_matching = guided
    if exhaustive:
        pycolmap.match_exhaustive(database, matching_options=options)
        return

    pairing = pycolmap.SequentialPairingOptions()
    pairing.overlap = 10
    pairing.quadratic_overlap = True
    pairing.loop_detection = False
    pycolmap.match_sequential(database, matching_options=options, pairing_options=pairing)


def _mapper_options(options: Any, threads: int) -> Any:
    """COLMAP's options of incremental or global mapping, filled in."""
    options.num_threads = threads
    options.random_seed = SEED
    options.min_model_size = 3
    return options


def _largest(
    models: dict[int, pycolmap.Reconstruction],
) -> tuple[pycolmap.Reconstruction | None, list[int]]:
    """The model with most registered images, or None; and those numbers of all models."""
    best = max(models.values(), key=lambda m: m.num_reg_images(), default=None)
    return best, sorted((m.num_reg_images() for m in models.values()), reverse=True)


def _matched(
    folder: Path,
    tag: str,
    features: str,
    files: list[str],
    cameras: int,
    settings: Poses,
    threads: int,
) -> tuple[Path, str]:
    """The database of an attempt with the features and matches of all photos `files`, and what was
    matched. features: the attempt whose features those are.

    Neighbours in COLMAP's sequence are those of one camera, so more of the photos are matched with
    all others where there are several.
    """
    import pycolmap

    thorough = tag != "plain"
    database = folder / f"{tag}.db"
    if features != tag:
        without_matches(folder / f"{features}.db", database, files)
    else:
        _say("features", tag)
        images = folder / (BROUGHT_OUT if tag == "contrast" else AS_EXPOSED)
        _extract(database, images, settings, thorough, threads, pycolmap.CameraMode.PER_FOLDER)

    _say("matching", tag)
    if settings.matching == "auto":
        count = len(files)
        exhaustive = count <= 60 or (thorough or cameras > 1) and count <= 150
    else:
        exhaustive = settings.matching == "exhaustive"
    _match(database, exhaustive, tag == "guided", threads)
    return database, "exhaustive" if exhaustive else "sequential"


def _mapped(
    database: Path, tag: str, held_out: list[str], threads: int
) -> tuple[pycolmap.Reconstruction | None, list[int]]:
    """The largest model that an attempt makes of the database's photos without the files
    `held_out`, or None; and the sizes of all.
    """
    import pycolmap

    _say("mapping", tag)
    folder = database.parent / tag
    folder.mkdir()
    inputs = _to_map(database, held_out), database.parent / AS_EXPOSED, folder
    if tag == "global":
        options = _mapper_options(pycolmap.GlobalPipelineOptions(), threads)
        return _largest(pycolmap.global_mapping(*inputs, options))

    return _largest(pycolmap.incremental_mapping(*inputs, incremental_options(threads)))


def incremental_options(threads: int) -> pycolmap.IncrementalPipelineOptions:
    """COLMAP's own, but for what the chain needs."""
    import pycolmap

    options = _mapper_options(pycolmap.IncrementalPipelineOptions(), threads)
    # else a model ends where it shares 20 photos with those that a bad start has cut short
    options.max_model_overlap = EVERY_PHOTO
    options.extract_colors = False  # nobody asks for them
    return options


def _to_map(database: Path, held_out: list[str]) -> Path:
    """The database that is mapped: without the matches of files that are held out."""
    if not held_out:
        return database
    copy = database.with_name(f"{database.stem}-mapped.db")
    without_matches(database, copy, held_out)
    return copy


def wanted(count: int, settings: Poses) -> float:
    """How many of `count` photos an attempt has to register, to be the last one."""
    if settings.min_registered != "auto":
        return settings.min_registered * count
    return count if count <= FEW else ENOUGH * count


def registered_images(model: pycolmap.Reconstruction | None) -> int:
    """How many of its images a model holds by LEAST_POINTS or more; 0 for None."""
    if model is None:
        return 0
    points = [model.image(number).num_points3D for number in model.reg_image_ids()]
    return sum(count >= LEAST_POINTS for count in points)


def reconstruct(
    capture: Path, photos: list[dict], settings: Poses, observe: Observe, threads: int
) -> tuple[pycolmap.Reconstruction, dict[str, str], dict[str, Placed], list[dict], list[dict]]:
    """(pycolmap Reconstruction of the photos that are not held out, file name -> photo name, the
    others as far as they could be placed by file name, attempts, the photos with their `split`).

    Photos are held out once the first matches say which of them the others can do without
    (`hold_out`). Raises InputError when too few photos connect.
    """
    import pycolmap

    pycolmap.logging.minloglevel = 2
    pycolmap.set_random_seed(SEED)
    with tempfile.TemporaryDirectory(prefix="heliograph-sfm-") as temporary:
        folder = Path(temporary)
        (folder / AS_EXPOSED).mkdir()
        names, cameras = write_inputs(capture, photos, folder / AS_EXPOSED, settings)
        files = list(names)  # in the order of the photos

        best, found_in = None, None
        by_attempt: dict[str, int] = {}  # how many photos each has registered
        attempts = []
        for tag in ATTEMPTS:
            facts: dict = {"attempt": tag, "cameras": cameras}
            if tag == "contrast":
                (folder / BROUGHT_OUT).mkdir()
                write_inputs(capture, photos, folder / BROUGHT_OUT, settings, as_exposed=False)
            if tag != "global":  # which maps the matches of the one before
                features = max(RICHER, key=by_attempt.__getitem__) if tag == "guided" else tag
                database, how = _matched(folder, tag, features, files, cameras, settings, threads)
                facts["matching"] = how
            if tag == "plain":
                photos = hold_out(photos, observe, matches_between(database, files))
                held_out = [f for f, p in zip(files, photos) if p["split"] == "test"]
                count = len(photos) - len(held_out)
            model, facts["models"] = _mapped(database, tag, held_out, threads)
            attempts.append(facts)

            by_attempt[tag] = registered_images(model)
            if by_attempt[tag] > registered_images(best):
                best, found_in = model, database
            registered = registered_images(best)
            if registered >= wanted(count, settings):
                break
            print(
                f"{registered} of {count} photos registered by the {tag} attempt",
                file=sys.stderr,
                flush=True,
            )
        placed = {}
        if found_in is not None and best is not None:
            adjust(best, threads)
            placed = place(found_in, best, held_out)

    if best is None or registered < max(3, 0.5 * count):
        raise InputError(
            f"only {registered} of {count} photos could be connected: "
            "too little overlap, texture or light",
            capture.parent.name,
            HINT,
        )
    return best, names, placed, attempts, photos


def sparse_points(
    model: pycolmap.Reconstruction, order: dict[int, int], others: dict[int, list[int]]
) -> dict:
    """The model's points that two or more views see, as points.npz holds them: xyz (n, 3),
    reprojection error in pixels (n,), offsets (n + 1,), views. Point k is seen by
    views[offsets[k] : offsets[k + 1]]. `order`: the model's image number -> index of the view;
    `others`: number of a point -> views that see it too and have not made it.
    """
    xyz = []
    error = []
    views = []
    for number, point in model.points3D.items():
        seen = sorted({order[e.image_id] for e in point.track.elements if e.image_id in order})
        if len(seen) >= 2:
            xyz.append(point.xyz)
            error.append(point.error)
            views.append(sorted({*seen, *others.get(number, [])}))

    offsets = np.concatenate([[0], np.cumsum([len(v) for v in views])])
    return {
        "xyz": np.array(xyz, float).reshape(-1, 3),
        "error": np.array(error, float),
        "offsets": offsets.astype(int),
        "views": np.array([v for seen in views for v in seen], int),
    }


def no_points() -> dict:
    """As `sparse_points`, where none were matched."""
    return {
        "xyz": np.zeros((0, 3)),
        "error": np.zeros(0),
        "offsets": np.zeros(1, int),
        "views": np.zeros(0, int),
    }
