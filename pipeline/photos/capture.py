"""Photos as linear light: decode, linearise, scale, undo exposure, collect masks and saturated
pixels, leave out what says nothing new.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from pipeline.base.config import Capture
from pipeline.base.errors import InputError
from pipeline.base.files import write_json
from pipeline.base.images import LARGEST_HALF, luminance, read_png, write_exr, write_png
from pipeline.base.progress import progress
from pipeline.photos.colour_space import LINEAR, Curve
from pipeline.photos.decode import Photo, decode
from pipeline.photos.focus import said_of_focus
from pipeline.photos.given_masks import check_owners, mask_file, read_mask
from pipeline.photos.radiance import Radiance, level_of, white_of
from pipeline.photos.scene_files import cameras_given, find_photos, left_out
from pipeline.photos.selection import Look, choose, look_at

BLACK = 1e-3  # luminance below which a pixel is black
LIE = 0.5  # stops by which EXIF may make photos differ more
NEVER = 1e6  # clip level of linear pictures, which have none
ANY = 0.004  # share of a scaled pixel's area: less than one of 15 x 15 pixels is rounding


@dataclass
class Converted:
    """A photo at working size: linear and saturated (h, w, 3), Rec.709; mask (h, w) bool or
    None; facts for photos.json.
    """

    linear: np.ndarray
    saturated: np.ndarray
    mask: np.ndarray | None
    facts: dict


def _resize(image: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Means over the area of each new pixel. `size`: width and height."""
    if (image.shape[1], image.shape[0]) == size:
        return image
    return cv2.resize(image, size, interpolation=cv2.INTER_AREA)


def _table(curve: Curve, full_scale: int) -> np.ndarray:
    """Linear value of every number that an integer picture can hold."""
    return curve(np.arange(full_scale + 1, dtype=np.float64) / full_scale)


def scaled(photo: Photo, size: tuple[int, int]) -> np.ndarray:
    """Linear Rec.709 (h, w, 3) at `size` (width, height): means of light, not of encoded numbers,
    and, where there is an alpha channel, of what the pixel shows of the object.

    One channel at a time, so that a large photo needs one channel's floats at full resolution.
    """
    alpha = photo.pixels[..., 3] / np.float32(photo.full_scale) if photo.pixels.shape[2] == 4 else 1
    weight = _resize(alpha, size) if isinstance(alpha, np.ndarray) else None
    channels = []
    for k, curve in enumerate(photo.space.curves):
        plane = np.ascontiguousarray(photo.pixels[..., k])
        if np.issubdtype(plane.dtype, np.integer):
            plane = _table(curve, int(photo.full_scale))[plane]
        else:
            plane = curve(plane)

        small = _resize(plane * alpha, size)
        channels.append(small if weight is None else small / np.maximum(weight, 1e-4))
    return photo.space.to_rec709(np.stack(channels, -1))


def saturated_pixels(photo: Photo, size: tuple[int, int], clip_fraction: float) -> np.ndarray:
    """Which channels of which pixels (h, w, 3) at `size` (width, height) hold a saturated value of
    the full resolution: one that reaches `clip_fraction` of the file's full scale.

    Its true value is unknown upwards, and so is every mean that it enters: one is enough. Yellow
    may be saturated in red and green and say all about blue; not so in other primaries than
    Rec.709's, where each channel is a mixture of the file's three.
    """
    if photo.space is LINEAR and not np.issubdtype(photo.pixels.dtype, np.integer):
        return np.zeros((*size[::-1], 3), bool)

    level = clip_fraction * photo.full_scale
    channels = []
    for k in range(3):
        full = photo.pixels[..., k] >= level
        if photo.pixels.shape[2] == 4:  # what is cut away shows nothing
            full &= photo.pixels[..., 3] > 0
        channels.append(_resize(full.astype(np.float32), size) > ANY)
    found = np.stack(channels, -1)
    return found if photo.space.is_rec709 else np.repeat(found.any(-1, keepdims=True), 3, -1)


def read_photo(path: Path, settings: Capture) -> Photo:
    """The decoded photo, its numbers read as `settings.encoding` says."""
    photo = decode(path, profiles=settings.encoding == "auto")
    if settings.encoding == "linear":
        photo.space = LINEAR
    return photo


def convert(scene: Path, path: Path, settings: Capture) -> Converted:
    """One photo at working size. Raises InputError for an unreadable photo or mask."""
    photo = read_photo(path, settings)
    height, width = photo.pixels.shape[:2]
    factor = min(1.0, settings.max_size / max(height, width))
    size = (max(1, round(width * factor)), max(1, round(height * factor)))

    linear = scaled(photo, size)
    saturated = saturated_pixels(photo, size, settings.clip_fraction)
    mask = _mask(scene, path, photo)
    curve = photo.space.curves[1]
    level = NEVER if photo.space is LINEAR else float(curve(np.array(settings.clip_fraction)))
    facts = photo.facts | {
        "original_size": [width, height],
        "width": size[0],
        "height": size[1],
        "clipped_share": float(saturated.any(-1).mean()),
        "clip_level": level,
        "brightness": brightness_of(linear),
    }
    small = None if mask is None else _resize(mask, size) >= 128
    if not np.issubdtype(photo.pixels.dtype, np.integer):
        facts["level"] = level_of(linear, small)
    return Converted(linear, saturated, small, facts)


def brightness_of(linear: np.ndarray) -> float:
    """Mean of log2 of a photo's luminance, in stops; what is black counts as BLACK."""
    return float(np.log2(np.maximum(luminance(linear), BLACK)).mean())


def _mask(scene: Path, path: Path, photo: Photo) -> np.ndarray | None:
    """The user's mask, uint8 (h, w), or the photo's alpha, or None."""
    file = mask_file(scene, path)
    if file is not None:
        return read_mask(file, (photo.pixels.shape[1], photo.pixels.shape[0]))
    if photo.pixels.shape[2] < 4:
        return None

    alpha = photo.pixels[..., 3]
    if alpha.min() >= 0.5 * photo.full_scale:
        return None
    return (alpha * np.float32(255 / photo.full_scale) + 0.5).astype(np.uint8)


def exposure_of(facts: dict) -> float | None:
    """Relative exposure t * ISO / N^2, or None where EXIF does not say."""
    if all(k in facts for k in ("time", "f_number", "iso")):
        return facts["time"] * facts["iso"] / facts["f_number"] ** 2
    return None


def normalise_exposure(photos: list[dict], mode: str) -> tuple[str, bool]:
    """Fill in each photo's `gain` (divide by it); what was done, and whether all exposures are
    known now. The logarithms of all gains sum to zero: the set as a whole becomes neither brighter
    nor darker.

    EXIF may lie: one that makes photos of one scene differ more than they do is not believed.
    """
    exposures = [exposure_of(p) for p in photos]
    for p in photos:
        p["gain"] = 1.0
    if mode == "none":
        return "not asked for", False

    known = [e for e in exposures if e is not None]
    if not known:
        return "no EXIF exposure", False
    if len(known) < len(photos):
        return f"left alone: only {len(known)} of {len(photos)} photos have EXIF exposure", False

    middle = np.exp(np.mean(np.log(known)))
    brightness = np.array([p["brightness"] for p in photos])
    before = float(np.std(brightness))
    after = float(np.std(brightness - np.log2(known)))
    if after > before + LIE:
        return (
            f"left alone: EXIF exposure contradicts the pictures, whose brightness would differ by "
            f"{after:.1f} stops instead of {before:.1f}"
        ), False
    for p, exposure in zip(photos, known):
        p["gain"] = float(exposure / middle)
    spread = max(known) / min(known)
    if spread < 1.001:
        return "all photos share one exposure", True
    return f"divided out; exposures differ by a factor of {spread:.2f}", True


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
) -> tuple[list[dict], list[Look]]:
    """Facts of every photo (photos.json) and how it looks, after its linear picture is in
    `out`/images/NAME.npy, its saturated pixels in `out`/saturated, and its mask, if it has one, in
    `out`/masks. What comes without a full scale may be brighter than a half can hold, and is kept
    as float32 until its scale is known.
    """
    (out / "images").mkdir()
    (out / "saturated").mkdir()
    photos = []
    looks = []
    for name, path, split in progress(found, "photos"):
        photo = convert(scene, path, settings)
        kept = np.float32 if "level" in photo.facts else np.float16
        np.save(out / "images" / f"{name}.npy", photo.linear.astype(kept))
        write_png(out / "saturated" / f"{name}.png", photo.saturated * np.uint8(255))
        if photo.mask is not None:
            (out / "masks").mkdir(exist_ok=True)
            write_png(out / "masks" / f"{name}.png", photo.mask * np.uint8(255))

        file = path.relative_to(scene).as_posix()
        own = {"name": name, "file": file, "split": split, "has_mask": photo.mask is not None}
        photos.append(own | photo.facts)
        white = white_of([photo.facts["level"]]) if "level" in photo.facts else 1.0
        looks.append(look_at(photo.linear / white))
    return photos, looks


def white_of_scene(photos: list[dict]) -> float:
    """The radiance that is white in the scene: 1, the full scale of pictures that have one, unless
    no photo has any.
    """
    if any("level" not in p for p in photos):
        return 1.0
    return white_of([p["level"] / p["gain"] for p in photos])


def divide_out(photos: list[dict], out: Path, white: float) -> None:
    """`out`/images/NAME.npy of every photo over its gain and the scene's white as NAME.exr; clip
    level and focal length follow. What is brighter than a half can hold is a lower bound: it counts
    as saturated.
    """
    for p in photos:
        raw = out / "images" / f"{p['name']}.npy"
        linear = np.load(raw).astype(np.float32) / (p["gain"] * white)
        write_exr(raw.with_suffix(".exr"), linear, half=True)
        beyond = linear > LARGEST_HALF
        if beyond.any():
            file = out / "saturated" / f"{p['name']}.png"
            write_png(file, np.maximum(read_png(file), beyond * np.uint8(255)))
        p["clip_level"] /= p["gain"]
        p |= focal_guess(p)
        raw.unlink()


def drop(photos: list[dict], looks: list[Look], out: Path) -> tuple[list[dict], dict]:
    """Take blurred and doubled photos away, with their files under `out`; the photos kept, and
    reason -> files.
    """
    reasons = choose(looks, [p["split"] == "fit" for p in photos])
    dropped: dict[str, list[str]] = {}
    kept = []
    for p, reason in zip(photos, reasons):
        if reason is None:
            kept.append(p)
            continue

        kind, other = reason
        twin = "" if other is None else f" (as {photos[other]['file']})"
        dropped.setdefault(kind, []).append(p["file"] + twin)
        for file in (f"images/{p['name']}.npy", f"saturated/{p['name']}.png"):
            (out / file).unlink()
        (out / "masks" / f"{p['name']}.png").unlink(missing_ok=True)
    return kept, dropped


def in_words(dropped: dict[str, list[str]]) -> list[str]:
    """One sentence for each reason why files are not used, with the first ten files."""
    return [
        f"{len(files)} not used, {reason}: {', '.join(files[:10])}{' ...' if files[10:] else ''}"
        for reason, files in dropped.items()
    ]


def capture(scene: Path, out: Path, settings: Capture) -> dict:
    """Convert every photo of `scene` into `out`/images/*.exr (half, linear), saturated/*.png,
    masks/*.png, photos.json and radiance.json (`Radiance`).

    Raises InputError naming the photo for unreadable files, mask of another size, black masks, too
    few photos.
    """
    found = find_photos(scene)
    check_owners(scene, [path for _, path, _ in found])
    dropped = left_out(scene, found)
    photos, looks = converted(found, scene, out, settings)
    if settings.leave_out == "auto" and not cameras_given(scene):
        photos, more = drop(photos, looks, out)
        dropped |= more

    if len(photos) < 3:
        raise InputError(
            f"only {len(photos)} photos show something of their own, the others are doubles",
            scene,
            "walk around the object, or set `capture: {leave_out: none}` to keep them all",
        )

    out_of_focus = said_of_focus([look.edge for look in looks])
    sentences = in_words(dropped) + out_of_focus
    for sentence in sentences:
        print(sentence, file=sys.stderr)
    masked = sum(p["has_mask"] for p in photos)
    exposure, known = normalise_exposure(photos, settings.exposure)
    white = white_of_scene(photos)
    divide_out(photos, out, white)
    Radiance(white).save(out)
    facts = {
        "scene": scene.name,
        "exposure": exposure,
        "exposure_known": known,
        "left_out": dropped,
        "out_of_focus": out_of_focus,
        "photos": photos,
    }
    write_json(out / "photos.json", facts)
    return {
        "photos": len(photos),
        "left_out": sum(len(files) for files in dropped.values()),
        "warnings": sentences,
        "masks": masked,
        "exposure": exposure,
        "white": white,
        "converted": sorted({p["note"] for p in photos if "note" in p}),
        "size": sorted({(p["width"], p["height"]) for p in photos}),
        "clipped_share": float(np.mean([p["clipped_share"] for p in photos])),
    }
