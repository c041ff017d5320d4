"""Which pixels show the object.

MASKERS: name of a method -> function(poses folder, rig, settings, threads) -> (photo name -> mask
(h, w) bool, facts). The user's masks or alpha win. Without them it is `plane`, which needs no
download, or `onnx` where the user asks for a network of their own.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from pipeline.base.config import Masks
from pipeline.base.errors import InputError
from pipeline.base.files import write_json
from pipeline.base.images import in_rows, read_exr, read_png, to_srgb8, write_png
from pipeline.geometry.cameras import Rig, load_cameras
from pipeline.masks.agreement import agreement
from pipeline.masks.network import network_masks
from pipeline.masks.plane import plane_masks

CURE = (
    "put masks (white = object, same names and sizes as the photos) into the scene's folder masks/"
)


def given_masks(poses: Path, rig: Rig, settings: Masks, threads: int) -> tuple[dict, dict]:
    """The user's masks or the photos' alpha, already undistorted by the poses stage."""
    folder = poses / "masks"
    missing = [v.name for v in rig.views if not (folder / f"{v.name}.png").exists()]
    if missing:
        raise InputError(
            f"no mask for {len(missing)} of {len(rig.views)} photos, first {missing[0]}",
            folder,
            CURE,
        )

    masks = {v.name: read_png(folder / f"{v.name}.png") > 127 for v in rig.views}
    return masks, {"why": "masks or alpha came with the photos"}


MASKERS = {"given": given_masks, "plane": plane_masks, "onnx": network_masks}


def choose(poses: Path, settings: Masks) -> str:
    """The method's name in MASKERS."""
    if settings.method != "auto":
        return settings.method
    return "given" if (poses / "masks").is_dir() else "plane"


def overlay(
    poses: Path, rig: Rig, masks: dict, height: int = 200, columns: int = 6, limit: int = 36
) -> np.ndarray:
    """Contact sheet: the photos, dimmed outside their mask, outline in magenta."""
    tiles = []
    for v in rig.views[:: max(1, int(np.ceil(len(rig.views) / limit)))]:
        size = (round(v.width * height / v.height), height)
        photo = cv2.resize(to_srgb8(read_exr(poses / v.image)), size, interpolation=cv2.INTER_AREA)
        mask = cv2.resize(masks[v.name].astype(np.uint8), size, interpolation=cv2.INTER_NEAREST)
        tile = np.where(mask[..., None] > 0, photo, photo // 3)
        outline = cv2.findContours(mask, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)[0]
        cv2.drawContours(tile, outline, -1, (255, 0, 255), 1)
        tiles.append(tile)
    return in_rows(tiles, columns)


def check(masks: dict, confidence: dict, method: str) -> list[str]:
    """Warnings; an InputError when the masks cannot be of use."""
    area = {name: float(m.mean()) for name, m in masks.items()}
    black = [name for name, a in area.items() if a == 0]
    if method == "given" and black:
        raise InputError(
            f"the mask of '{black[0]}' is all black", "masks", "paint the object white there"
        )

    middle = float(np.median(list(area.values())))
    if middle < 0.003 or middle > 0.85 or len(black) > 0.5 * len(masks):
        raise InputError(
            "the object could not be told from its surroundings "
            f"(median mask {100 * middle:.1f} % of the photo, "
            f"{len(black)} of {len(masks)} empty)",
            "masks",
            CURE,
        )

    unsure = [name for name, c in confidence.items() if not c["carve"]]
    if not unsure:
        return []
    return [
        f"{len(unsure)} masks do not agree with the others and will not carve: "
        f"{', '.join(unsure[:8])}"
    ]


def make_masks(poses: Path, out: Path, settings: Masks, threads: int) -> dict:
    """Write masks/<name>.png, confidence.json and overlay.jpg into `out`; returns metrics."""
    rig = load_cameras(poses / "cameras.json")
    method = choose(poses, settings)
    masks, facts = MASKERS[method](poses, rig, settings, threads)
    confidence = agreement(rig, masks)
    warnings = check(masks, confidence, method)

    (out / "masks").mkdir()
    for v in rig.views:
        write_png(out / "masks" / f"{v.name}.png", masks[v.name] * np.uint8(255))
    write_json(out / "confidence.json", confidence)
    write_png(out / "overlay.jpg", overlay(poses, rig, masks))

    return {
        "method": method,
        "area_share": float(np.mean([m.mean() for m in masks.values()])),
        "warnings": warnings,
        "mean_confidence": float(np.mean([c["confidence"] for c in confidence.values()])),
    } | facts
