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

HINT = "photograph with about 80 % overlap, all the way round, on a textured ground, without zooming or moving the object"


def write_inputs(
    capture: Path, photos: list[dict], folder: Path, settings: Poses
) -> tuple[dict[str, str], bool]:
    """8-bit copies for COLMAP with plain ASCII names; returns file name -> photo name, and whether
    one camera fits all.
    """
    names, kinds = {}, set()
    for k, p in enumerate(progress(photos, "photos for matching")):
        image = Image.fromarray(to_srgb8(read_exr(capture / "images" / f"{p['name']}.exr")))
        image.thumbnail((settings.max_size, settings.max_size), Image.Resampling.LANCZOS)
        tags = Image.Exif()
        if p.get("focal_35mm"):
            tags.get_ifd(0x8769)[0xA405] = int(round(p["focal_35mm"]))
        image.save(folder / f"{k:05d}.jpg", quality=97, subsampling=0, exif=tags)
        names[f"{k:05d}.jpg"] = p["name"]
        kinds.add((p["width"], p["height"], p.get("focal_35mm"), p.get("focal_mm"), p.get("model")))
    return names, (len(kinds) == 1 if settings.camera == "auto" else settings.camera == "single")


def _attempt(
    folder: Path, tag: str, count: int, settings: Poses, single: bool, thorough: bool, threads: int
):
    """One run of extraction, matching and mapping; the model with most images, or None."""
    import pycolmap

    database = folder / f"{tag}.db"
    extraction, matching = pycolmap.FeatureExtractionOptions(), pycolmap.FeatureMatchingOptions()
    extraction.num_threads = matching.num_threads = threads
    extraction.use_gpu = matching.use_gpu = False
    extraction.max_image_size = settings.max_size
    extraction.sift.max_num_features = (
        max(8192, settings.features) if thorough else settings.features
    )
    extraction.sift.estimate_affine_shape = extraction.sift.domain_size_pooling = thorough
    matching.guided_matching = thorough
    reader = pycolmap.ImageReaderOptions()
    reader.camera_model = "SIMPLE_RADIAL"
    print(f"features ({tag})", file=sys.stderr, flush=True)
    pycolmap.extract_features(
        database,
        folder / "images",
        reader_options=reader,
        extraction_options=extraction,
        camera_mode=pycolmap.CameraMode.SINGLE if single else pycolmap.CameraMode.PER_IMAGE,
    )
    print(f"matching ({tag})", file=sys.stderr, flush=True)
    exhaustive = (
        count <= 60 or thorough and count <= 150
        if settings.matching == "auto"
        else settings.matching == "exhaustive"
    )
    if exhaustive:
        pycolmap.match_exhaustive(database, matching_options=matching)
    else:
        pairing = pycolmap.SequentialPairingOptions()
        pairing.overlap, pairing.quadratic_overlap, pairing.loop_detection = 10, True, False
        pycolmap.match_sequential(database, matching_options=matching, pairing_options=pairing)
    print(f"mapping ({tag})", file=sys.stderr, flush=True)
    options = pycolmap.IncrementalPipelineOptions()
    options.num_threads, options.random_seed, options.min_model_size = threads, settings.seed, 3
    models = pycolmap.incremental_mapping(database, folder / "images", folder / tag, options)
    best = max(models.values(), key=lambda m: m.num_reg_images(), default=None)
    return best, {
        "attempt": tag,
        "matching": "exhaustive" if exhaustive else "sequential",
        "models": sorted((m.num_reg_images() for m in models.values()), reverse=True),
    }


def _global_attempt(folder: Path, settings: Poses, threads: int):
    """Global mapping (GLOMAP) of the matches that the thorough attempt found."""
    import pycolmap

    print("mapping (global)", file=sys.stderr, flush=True)
    options = pycolmap.GlobalPipelineOptions()
    options.num_threads, options.random_seed, options.min_model_size = threads, settings.seed, 3
    (folder / "global").mkdir()
    models = pycolmap.global_mapping(
        folder / "thorough.db", folder / "images", folder / "global", options
    )
    return (
        max(models.values(), key=lambda m: m.num_reg_images(), default=None),
        {
            "attempt": "global",
            "models": sorted((m.num_reg_images() for m in models.values()), reverse=True),
        },
    )


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
        best, attempts = None, []
        for tag in ("plain", "thorough", "global"):
            if tag == "global":
                model, facts = _global_attempt(folder, settings, threads)
            else:
                (folder / tag).mkdir()
                model, facts = _attempt(
                    folder, tag, len(photos), settings, single, tag == "thorough", threads
                )
            attempts.append(facts | {"single_camera": single})
            if model is not None and (
                best is None or model.num_reg_images() > best.num_reg_images()
            ):
                best = model
            if best is not None and best.num_reg_images() >= settings.min_registered * len(photos):
                break
            print(
                f"{0 if best is None else best.num_reg_images()} of {len(photos)} photos registered by the {tag} attempt",
                file=sys.stderr,
                flush=True,
            )
    registered = 0 if best is None else best.num_reg_images()
    if registered < max(3, 0.5 * len(photos)):
        raise InputError(
            f"only {registered} of {len(photos)} photos could be connected: too little overlap or texture",
            capture.parent.name,
            HINT,
        )
    return best, names, attempts


def sparse_points(model, order: dict[int, int]):
    """xyz (n, 3), rgb (n, 3) uint8, error (n,), offsets (n + 1,), views: which views see each point
    (CSR).
    """
    xyz, rgb, error, views = [], [], [], []
    for point in model.points3D.values():
        seen = sorted({order[e.image_id] for e in point.track.elements if e.image_id in order})
        if len(seen) >= 2:
            (
                xyz.append(point.xyz),
                rgb.append(point.color),
                error.append(point.error),
                views.append(seen),
            )
    offsets = np.concatenate([[0], np.cumsum([len(v) for v in views])])
    return (
        np.array(xyz, float).reshape(-1, 3),
        np.array(rgb, np.uint8).reshape(-1, 3),
        np.array(error, float),
        offsets.astype(int),
        np.array([v for seen in views for v in seen], int),
    )
