"""Which pixels show the object. MASKERS: name -> function(poses folder, rig, settings) -> {name:
bool mask}, facts.

The user's masks or alpha win; else `plane` (no download), or `onnx` when the user has a network
installed.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from pipeline.base.config import Masks
from pipeline.base.errors import InputError
from pipeline.base.files import write_json
from pipeline.base.images import read_exr, read_png, to_srgb8, write_png
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
    return {v.name: read_png(folder / f"{v.name}.png") > 127 for v in rig.views}, {
        "why": "masks or alpha came with the photos"
    }


MASKERS = {"given": given_masks, "plane": plane_masks, "onnx": network_masks}


def choose(poses: Path, settings: Masks) -> str:
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
        cv2.drawContours(
            tile,
            cv2.findContours(mask, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)[0],
            -1,
            (255, 0, 255),
            1,
        )
        tiles.append(tile)
    width = max(t.shape[1] for t in tiles)
    tiles = [np.pad(t, ((0, 0), (0, width - t.shape[1]), (0, 0))) for t in tiles]
    tiles += [np.zeros_like(tiles[0])] * (-len(tiles) % columns)
    return np.concatenate(
        [np.concatenate(tiles[k : k + columns], 1) for k in range(0, len(tiles), columns)]
    )


def check(masks: dict, confidence: dict, method: str) -> list[str]:
    """Warnings; an InputError when the masks cannot be of use."""
    share = {name: float(m.mean()) for name, m in masks.items()}
    black = [name for name, s in share.items() if s == 0]
    if method == "given" and black:
        raise InputError(
            f"the mask of '{black[0]}' is all black", "masks", "paint the object white there"
        )
    middle = float(np.median(list(share.values())))
    if middle < 0.003 or middle > 0.85 or len(black) > 0.5 * len(masks):
        raise InputError(
            f"the object could not be told from its surroundings (median mask {100 * middle:.1f} % of the photo, "
            f"{len(black)} of {len(masks)} empty)",
            "masks",
            CURE,
        )
    unsure = [name for name, c in confidence.items() if not c["carve"]]
    return (
        [
            f"{len(unsure)} masks do not agree with the others and will not carve: {', '.join(unsure[:8])}"
        ]
        if unsure
        else []
    )


def make_masks(poses: Path, out: Path, settings: Masks, threads: int) -> dict:
    """Write masks/<name>.png, confidence.json and overlay.jpg into `out`; returns metrics."""
    rig, method = load_cameras(poses / "cameras.json"), choose(poses, settings)
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
