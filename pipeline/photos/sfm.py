"""Structure from motion with COLMAP on the CPU: SIFT, matching, incremental mapping.

Too few photos registered: a more thorough second attempt, then global mapping of its matches. The
largest model is kept.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image

from pipeline.base.config import Poses
from pipeline.base.errors import InputError
from pipeline.base.images import read_exr, to_srgb8
from pipeline.base.progress import progress

HINT = (
    "photograph with about 80 % overlap, all the way round, on a textured ground, "
    "without zooming or moving the object"
)
EXIF_IFD = 0x8769
FOCAL_35MM = 0xA405


def write_inputs(
    capture: Path, photos: list[dict], folder: Path, settings: Poses
) -> tuple[dict[str, str], bool]:
    """8-bit copies for COLMAP with plain ASCII names; returns file name -> photo name, and whether
    one camera fits all.
    """
    names = {}
    kinds = set()

    for k, p in enumerate(progress(photos, "photos for matching")):
        image = Image.fromarray(to_srgb8(read_exr(capture / "images" / f"{p['name']}.exr")))
        image.thumbnail((settings.max_size, settings.max_size), Image.Resampling.LANCZOS)

        tags = Image.Exif()
        if p.get("focal_35mm"):
            tags.get_ifd(EXIF_IFD)[FOCAL_35MM] = int(round(p["focal_35mm"]))
        image.save(folder / f"{k:05d}.jpg", quality=97, subsampling=0, exif=tags)

        names[f"{k:05d}.jpg"] = p["name"]
        kinds.add((p["width"], p["height"], p.get("focal_35mm"), p.get("focal_mm"), p.get("model")))

    single = len(kinds) == 1 if settings.camera == "auto" else settings.camera == "single"
    return names, single


def _say(step: str, tag: str) -> None:
    """Announce a step of COLMAP, which shows no progress of its own."""
    print(f"{step} ({tag})", file=sys.stderr, flush=True)


def _extract(
    database: Path, images: Path, settings: Poses, single: bool, thorough: bool, threads: int
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
        camera_mode=pycolmap.CameraMode.SINGLE if single else pycolmap.CameraMode.PER_IMAGE,
    )


def _match(database: Path, exhaustive: bool, thorough: bool, threads: int) -> None:
    """Match the features of all pairs of photos, or of neighbours in their sequence."""
    import pycolmap

    options = pycolmap.FeatureMatchingOptions()
    options.num_threads = threads
    options.use_gpu = False
    options.guided_matching = thorough
    if exhaustive:
        pycolmap.match_exhaustive(database, matching_options=options)
        return

    pairing = pycolmap.SequentialPairingOptions()
    pairing.overlap = 10
    pairing.quadratic_overlap = True
    pairing.loop_detection = False
    pycolmap.match_sequential(database, matching_options=options, pairing_options=pairing)


def _mapper_options(options, settings: Poses, threads: int):
    """COLMAP's options of incremental or global mapping, filled in."""
    options.num_threads = threads
    options.random_seed = settings.seed
    options.min_model_size = 3
    return options


def _largest(models: dict):
    """The model with most registered images, or None; and those numbers of all models."""
    best = max(models.values(), key=lambda m: m.num_reg_images(), default=None)
    return best, sorted((m.num_reg_images() for m in models.values()), reverse=True)


def _attempt(
    folder: Path, tag: str, count: int, settings: Poses, single: bool, thorough: bool, threads: int
):
    """One run of extraction, matching and mapping; the model with most images, or None."""
    import pycolmap

    database = folder / f"{tag}.db"
    images = folder / "images"
    _say("features", tag)
    _extract(database, images, settings, single, thorough, threads)

    _say("matching", tag)
    if settings.matching == "auto":
        exhaustive = count <= 60 or thorough and count <= 150
    else:
        exhaustive = settings.matching == "exhaustive"
    _match(database, exhaustive, thorough, threads)

    _say("mapping", tag)
    options = _mapper_options(pycolmap.IncrementalPipelineOptions(), settings, threads)
    models = pycolmap.incremental_mapping(database, images, folder / tag, options)

    best, registered = _largest(models)
    return best, {
        "attempt": tag,
        "matching": "exhaustive" if exhaustive else "sequential",
        "models": registered,
    }


def _global_attempt(folder: Path, settings: Poses, threads: int):
    """Global mapping (GLOMAP) of the matches that the thorough attempt found."""
    import pycolmap

    _say("mapping", "global")
    options = _mapper_options(pycolmap.GlobalPipelineOptions(), settings, threads)
    (folder / "global").mkdir()
    models = pycolmap.global_mapping(
        folder / "thorough.db", folder / "images", folder / "global", options
    )

    best, registered = _largest(models)
    return best, {"attempt": "global", "models": registered}


def registered_images(model) -> int:
    """How many images a model holds; 0 for None."""
    return 0 if model is None else model.num_reg_images()


def reconstruct(capture: Path, photos: list[dict], settings: Poses, threads: int):
    """(pycolmap Reconstruction, file name -> photo name, attempts). InputError when too few photos
    connect.
    """
    import pycolmap

    pycolmap.logging.minloglevel = 2
    pycolmap.set_random_seed(settings.seed)
    with tempfile.TemporaryDirectory(prefix="heliograph-sfm-") as temporary:
        folder = Path(temporary)
        (folder / "images").mkdir()
        names, single = write_inputs(capture, photos, folder / "images", settings)

        best = None
        attempts = []
        for tag in ("plain", "thorough", "global"):
            if tag == "global":
                model, facts = _global_attempt(folder, settings, threads)
            else:
                (folder / tag).mkdir()
                model, facts = _attempt(
                    folder, tag, len(photos), settings, single, tag == "thorough", threads
                )
            attempts.append(facts | {"single_camera": single})

            if registered_images(model) > registered_images(best):
                best = model
            registered = registered_images(best)
            if registered and registered >= settings.min_registered * len(photos):
                break
            print(
                f"{registered} of {len(photos)} photos registered by the {tag} attempt",
                file=sys.stderr,
                flush=True,
            )

    if registered < max(3, 0.5 * len(photos)):
        raise InputError(
            f"only {registered} of {len(photos)} photos could be connected: "
            "too little overlap or texture",
            capture.parent.name,
            HINT,
        )
    return best, names, attempts


def sparse_points(model, order: dict[int, int]):
    """The model's points that two or more views see: xyz (n, 3), rgb (n, 3) uint8, reprojection
    error in pixels (n,), offsets (n + 1,), views. Point k is seen by views[offsets[k] : offsets[k +
    1]]. `order`: the model's image number -> index of the view.
    """
    xyz = []
    rgb = []
    error = []
    views = []
    for point in model.points3D.values():
        seen = sorted({order[e.image_id] for e in point.track.elements if e.image_id in order})
        if len(seen) >= 2:
            xyz.append(point.xyz)
            rgb.append(point.color)
            error.append(point.error)
            views.append(seen)

    offsets = np.concatenate([[0], np.cumsum([len(v) for v in views])])
    return (
        np.array(xyz, float).reshape(-1, 3),
        np.array(rgb, np.uint8).reshape(-1, 3),
        np.array(error, float),
        offsets.astype(int),
        np.array([v for seen in views for v in seen], int),
    )
