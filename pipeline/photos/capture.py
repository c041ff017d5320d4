"""Photos as linear light: decode, turn upright, linearise, undo exposure, resize, collect masks.

Names: a photo's name is its path below `images/` (or below the scene folder) without suffix, joined
by "_".
"""

from __future__ import annotations

import io
import json
import os
import sys
from pathlib import Path
from typing import cast

import cv2
import numpy as np
from PIL import Image, ImageCms, ImageOps

from pipeline.base.config import Capture
from pipeline.base.errors import InputError
from pipeline.base.files import write_json
from pipeline.base.images import read_exr, srgb_to_linear, write_exr, write_png
from pipeline.base.progress import progress

SUFFIXES = (".jpg", ".jpeg", ".png", ".tif", ".tiff", ".exr")
MASK_SUFFIXES = (".png", ".PNG", ".jpg")
CAMERA_FILES = ("transforms.json", "transforms_train.json")
ORIENTED = {
    2: lambda a: a[:, ::-1],
    3: lambda a: a[::-1, ::-1],
    4: lambda a: a[::-1],
    5: lambda a: a.swapaxes(0, 1),
    6: lambda a: np.rot90(a, 3),
    7: lambda a: np.rot90(a, 2).swapaxes(0, 1),
    8: lambda a: np.rot90(a, 1),
}
# pycolmap brings its own libpng and zlib: if it is loaded first, OpenCV binds to a mixture of both
# and aborts at its first PNG. One round trip here, before any stage loads pycolmap, binds OpenCV to
# its own.
cv2.imdecode(cv2.imencode(".png", np.zeros((2, 2), np.uint16))[1], cv2.IMREAD_UNCHANGED)


def camera_file(scene: Path) -> Path | None:
    """The scene's transforms file, if it has one."""
    return next((scene / name for name in CAMERA_FILES if (scene / name).exists()), None)


def path_in_scene(scene: Path, name: str, file: Path) -> Path:
    """The path below `scene` that `file` (a transforms file) calls `name`, relative to the scene or
    absolute. Raises InputError for a name that leaves the scene's folder.

    `..` is undone in the text, before the disk is asked, so that what is opened is what was
    checked. Symbolic links are not resolved: those in a scene's folder, say images/ on another
    disk, are the user's own and keep working.
    """
    for top in (os.path.abspath(scene), os.path.realpath(scene)):
        full = os.path.normpath(os.path.join(top, name))
        if full.startswith(os.path.join(top, "")):
            return scene / os.path.relpath(full, top)

    raise InputError(
        f"the photo '{name}' lies outside the scene's folder",
        file,
        f"move the photo into {scene} and correct its path",
    )


def named_frames(scene: Path, file: Path) -> list[Path]:
    """Photos that a transforms file names (suffix may be missing). A missing photo is an
    InputError.
    """
    try:
        frames = json.loads(file.read_text(encoding="utf-8"))["frames"]
        stems = [path_in_scene(scene, frame["file_path"], file) for frame in frames]
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(
            f"not a transforms file ({error!r})", file, "see NeRF-synthetic or nerfstudio's format"
        ) from error
    out: list[Path] = []
    missing: list[Path] = []
    for stem in stems:
        found = (
            stem
            if stem.suffix.lower() in SUFFIXES
            else next((p for s in SUFFIXES if (p := stem.with_name(stem.name + s)).exists()), stem)
        )
        (out if found.exists() else missing).append(found)
    if missing:
        raise InputError(
            f"{len(missing)} of {len(stems)} frames name photos that are not there, first "
            f"{missing[0].relative_to(scene)}",
            file,
            "add the photos or remove those frames",
        )
    return out


def photo_name(scene: Path, path: Path) -> str:
    """Name of a photo below `scene`; only a known image suffix is taken off, so that
    `frame.001.png` and `frame.002.png` differ.
    """
    relative = path.relative_to(scene)
    parts = (relative.with_suffix("") if relative.suffix.lower() in SUFFIXES else relative).parts
    return "_".join(parts[1:] if parts[0] == "images" and len(parts) > 1 else parts)


def find_photos(scene: Path) -> list[tuple[str, Path, str]]:
    """(name, path, split) of every photo; split "test" for frames of transforms_test.json."""
    if not scene.is_dir():
        raise InputError(
            "the scene folder does not exist", scene, "correct `photos:` in the configuration"
        )
    cameras, out = camera_file(scene), []
    if cameras:
        out = [(photo_name(scene, p), p, "fit") for p in named_frames(scene, cameras)]
        test = scene / "transforms_test.json"
        if test.exists():
            out += [(photo_name(scene, p), p, "test") for p in named_frames(scene, test)]
    else:
        folder = scene / "images" if (scene / "images").is_dir() else scene
        paths = sorted(
            p
            for p in folder.rglob("*")
            if p.suffix.lower() in SUFFIXES and not p.name.startswith(".")
        )
        out = [
            (photo_name(scene, p), p, "fit")
            for p in paths
            if "masks" not in p.relative_to(folder).parts
        ]
    if not out:
        raise InputError(
            "no photos found", scene, "put .jpg, .png, .tif or .exr files into its folder images/"
        )
    if len(out) < 3:
        raise InputError(
            f"{len(out)} photo(s) found; at least 3 are needed, 20-60 around the object are good",
            scene,
            "take more photos with about 80 % overlap",
        )
    names = [n for n, _, _ in out]
    twice = sorted({n for n in names if names.count(n) > 1})
    if twice:
        raise InputError(
            f"two photos are called '{twice[0]}'", scene, "give every photo a name of its own"
        )
    return out


def unused_photos(scene: Path, found: list[tuple[str, Path, str]]) -> list[str]:
    """Photos in images/ that a transforms file does not name: they are left out, and said so."""
    used = {path.resolve() for _, path, _ in found}
    files = sorted((scene / "images").rglob("*")) if camera_file(scene) else []
    return [
        p.relative_to(scene).as_posix()
        for p in files
        if p.suffix.lower() in SUFFIXES and p.resolve() not in used
    ]


def _to_rgb(image: Image.Image) -> tuple[np.ndarray, str]:
    """A Pillow image as float (h, w, 3 or 4) in [0, 1] and a note on what was converted."""
    if image.mode == "CMYK":
        profile = image.info.get("icc_profile")
        if profile:
            source = ImageCms.ImageCmsProfile(io.BytesIO(profile))
            target = ImageCms.createProfile("sRGB")
            converted = ImageCms.profileToProfile(image, source, target, outputMode="RGB")
            image = cast(Image.Image, converted)  # None only where it works in place
            note = "CMYK by its ICC profile"
        else:
            image = image.convert("RGB")
            note = "CMYK without a profile, by the plain formula"
        return np.asarray(image, np.float32) / 255, note

    if image.mode in ("F", "I"):
        raise ValueError(
            f"32 bits per channel (Pillow mode {image.mode}): save linear pictures as EXR"
        )
    alpha = image.mode in ("RGBA", "LA", "PA") or "transparency" in image.info
    return np.asarray(image.convert("RGBA" if alpha else "RGB"), np.float32) / 255, ""


def decode(path: Path) -> tuple[np.ndarray, dict]:
    """Encoded values in [0, 1] (EXR: linear), upright, (h, w, 3 or 4), and EXIF facts. InputError
    if unreadable.
    """
    if path.suffix.lower() == ".exr":
        pixels = read_exr(path)
        if not np.isfinite(pixels).all():
            raise InputError(
                "the picture holds NaN or infinity",
                path,
                "export it again without them, or leave it out",
            )
        if pixels.ndim == 2:
            pixels = np.repeat(pixels[..., None], 3, -1)
        return pixels, {"linear": True}

    try:
        data = path.read_bytes()
        with Image.open(io.BytesIO(data)) as image:
            image.load()  # Pillow refuses truncated files, OpenCV would not
            tags = image.getexif()
            facts = _exif_facts(tags)
            if not path.suffix.lower().startswith(".jp"):
                deep = cv2.imdecode(
                    np.frombuffer(data, np.uint8),
                    cv2.IMREAD_UNCHANGED | cv2.IMREAD_IGNORE_ORIENTATION,
                )
                if deep is not None and deep.dtype == np.uint16:
                    return _oriented(_deep_rgb(deep), tags), facts | {"note": "16 bit"}
            pixels, note = _to_rgb(image)
    except (
        OSError,
        SyntaxError,
        ValueError,
        ImageCms.PyCMSError,
        Image.DecompressionBombError,
    ) as error:
        raise InputError(
            f"the photo cannot be read ({error})",
            path,
            "copy it again from the camera, or remove it",
        ) from error
    return _oriented(pixels, tags), facts | ({"note": note} if note else {})


def _deep_rgb(deep: np.ndarray) -> np.ndarray:
    """OpenCV's 16-bit BGR(A) or grey -> float RGB(A)."""
    deep = deep.astype(np.float32) / 65535
    if deep.ndim == 2:
        return np.repeat(deep[..., None], 3, -1)
    return deep[..., [2, 1, 0, 3][: deep.shape[2]]]


def _oriented(pixels: np.ndarray, tags: Image.Exif) -> np.ndarray:
    return np.ascontiguousarray(ORIENTED.get(tags.get(0x0112, 1), lambda a: a)(pixels))


def _exif_facts(tags: Image.Exif) -> dict:
    """Exposure and focal length from EXIF; missing or zero values are left out."""
    ifd = tags.get_ifd(0x8769)
    number = lambda key: (
        float(ifd[key]) if key in ifd and ifd[key] and float(ifd[key]) > 0 else None
    )
    iso = ifd.get(0x8827)
    iso = float(iso[0] if isinstance(iso, tuple) else iso) if iso else None
    facts = {
        "make": str(tags.get(0x010F, "")).strip("\0 "),
        "model": str(tags.get(0x0110, "")).strip("\0 "),
        "focal_35mm": number(0xA405),
        "focal_mm": number(0x920A),
        "time": number(0x829A),
        "f_number": number(0x829D),
        "iso": iso,
    }
    return {k: v for k, v in facts.items() if v}


def exposure_of(facts: dict) -> float | None:
    """Relative exposure t * ISO / N^2, or None where EXIF does not say."""
    if all(k in facts for k in ("time", "f_number", "iso")):
        return facts["time"] * facts["iso"] / facts["f_number"] ** 2
    return None


def mask_file(scene: Path, photo: Path) -> Path | None:
    """The mask that the user gave for a photo, if there is one: masks/<stem of the photo>.png."""
    candidates = (scene / "masks" / (photo.stem + suffix) for suffix in MASK_SUFFIXES)
    return next((file for file in candidates if file.exists()), None)


def _read_mask(scene: Path, path: Path, pixels: np.ndarray) -> np.ndarray | None:
    """The user's mask (h, w) in [0, 1], or the photo's alpha, or None."""
    file = mask_file(scene, path)
    if file is None:
        return pixels[..., 3] if pixels.shape[2] == 4 and pixels[..., 3].min() < 0.5 else None

    try:
        with Image.open(file) as image:
            mask = np.asarray(ImageOps.exif_transpose(image).convert("L"), np.float32) / 255
    except (OSError, SyntaxError, ValueError) as error:
        raise InputError(
            f"the mask cannot be read ({error})", file, "save it again as PNG"
        ) from error
    if mask.shape != pixels.shape[:2]:
        raise InputError(
            f"the mask is {mask.shape[1]}x{mask.shape[0]}, its photo {pixels.shape[1]}x"
            f"{pixels.shape[0]}",
            file,
            "save the mask at the photo's size",
        )
    if mask.max() < 0.5:
        raise InputError(
            "the mask is all black", file, "paint the object white, or delete the mask"
        )
    return mask


def _resize(image: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    if (image.shape[1], image.shape[0]) == size:
        return image
    return cv2.resize(image, size, interpolation=cv2.INTER_AREA)


def convert(
    scene: Path, path: Path, settings: Capture
) -> tuple[np.ndarray, np.ndarray | None, dict]:
    """One photo: linear (h, w, 3) at working size, mask (h, w) in [0, 1] or None, facts."""
    pixels, facts = decode(path)
    height, width = pixels.shape[:2]
    mask = _read_mask(scene, path, pixels)

    linear_input = facts.pop("linear", False) or settings.encoding == "linear"
    color = pixels[..., :3]
    clipped = float((color.max(-1) >= settings.clip_fraction).mean()) if not linear_input else 0.0
    linear = color if linear_input else srgb_to_linear(color)
    clip = 1e6 if linear_input else float(srgb_to_linear(np.array(settings.clip_fraction)))

    factor = min(1.0, settings.max_size / max(height, width))
    size = (round(width * factor), round(height * factor))
    if pixels.shape[2] == 4:  # mean colour of what the pixel shows of the object
        alpha = pixels[..., 3:]
        color = _resize(np.ascontiguousarray(linear * alpha), size)
        small = color / np.maximum(_resize(alpha[..., 0], size), 1e-4)[..., None]
    else:
        small = _resize(linear, size)

    facts |= {
        "original_size": [width, height],
        "width": size[0],
        "height": size[1],
        "clipped_share": clipped,
        "clip_level": clip,
    }
    return small, None if mask is None else _resize(mask, size), facts


def normalise_exposure(photos: list[dict], mode: str) -> str:
    """Fill in each photo's `gain` (divide by it) and say what was done."""
    exposures = [exposure_of(p) for p in photos]
    for p in photos:
        p["gain"] = 1.0
    if mode == "none":
        return "not asked for"

    known = [e for e in exposures if e is not None]
    if not known:
        return "no EXIF exposure"
    if len(known) < len(photos):
        return f"left alone: only {len(known)} of {len(photos)} photos have EXIF exposure"

    middle = float(np.median(known))
    for p, exposure in zip(photos, known):
        p["gain"] = exposure / middle
    spread = max(known) / min(known)
    if spread < 1.001:
        return "all photos share one exposure"
    return f"divided out; exposures differ by a factor of {spread:.2f}"


def focal_guess(photo: dict) -> dict:
    """Focal length in working pixels for a start: from EXIF's 35 mm equivalent, else 1.2 x the long
    side as COLMAP.
    """
    side = max(photo["width"], photo["height"])
    if "focal_35mm" in photo:
        return {
            "focal_px": photo["focal_35mm"] / 36 * side,
            "focal_source": "EXIF, 35 mm equivalent",
        }
    return {"focal_px": 1.2 * side, "focal_source": "assumed, 1.2 x long side"}


def converted(
    found: list[tuple[str, Path, str]], scene: Path, out: Path, settings: Capture
) -> list:
    """Facts of every photo (photos.json), after its linear picture is in `out`/images/NAME.npy and
    its mask, if it has one, in `out`/masks.
    """
    (out / "images").mkdir()
    photos = []
    for name, path, split in progress(found, "photos"):
        linear, mask, facts = convert(scene, path, settings)
        np.save(out / "images" / f"{name}.npy", linear.astype(np.float16))
        if mask is not None:
            (out / "masks").mkdir(exist_ok=True)
            write_png(out / "masks" / f"{name}.png", (mask >= 0.5) * np.uint8(255))

        file = path.relative_to(scene).as_posix()
        own = {"name": name, "file": file, "split": split, "has_mask": mask is not None}
        photos.append(own | facts)
    return photos


def divide_out_gains(photos: list[dict], images: Path) -> None:
    """NAME.npy of every photo over its gain as NAME.exr; clip level and focal length follow."""
    for p in photos:
        raw = images / f"{p['name']}.npy"
        write_exr(raw.with_suffix(".exr"), np.load(raw).astype(np.float32) / p["gain"], half=True)
        p["clip_level"] /= p["gain"]
        p |= focal_guess(p)
        raw.unlink()


def capture(scene: Path, out: Path, settings: Capture) -> dict:
    """Convert every photo of `scene` into `out`/images/*.exr (half, linear), masks/*.png and
    photos.json.

    Raises InputError naming the photo for unreadable files, mask of another size, black masks, too
    few photos.
    """
    found = find_photos(scene)
    cameras = camera_file(scene)
    unused = unused_photos(scene, found)
    if cameras and unused:
        text = f"{len(unused)} photos are not named by {cameras.name} and not used, first"
        print(f"{text} {unused[0]}", file=sys.stderr)

    photos = converted(found, scene, out, settings)
    masked = sum(p["has_mask"] for p in photos)
    exposure = normalise_exposure(photos, settings.exposure)
    divide_out_gains(photos, out / "images")
    facts = {"scene": scene.name, "exposure": exposure, "unused": unused, "photos": photos}
    write_json(out / "photos.json", facts)
    return {
        "photos": len(photos),
        "unused": len(unused),
        "masks": masked,
        "exposure": exposure,
        "size": sorted({(p["width"], p["height"]) for p in photos}),
        "clipped_share": float(np.mean([p["clipped_share"] for p in photos])),
    }
