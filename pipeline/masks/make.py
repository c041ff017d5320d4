"""Which pixels show the object.

MASKERS: name of a method -> function(poses folder, rig, settings, threads) -> (photo name -> mask
(h, w) bool, facts). The user's masks or alpha win where all photos have them. Otherwise it is
`plane`, which needs no download and takes masks of some photos as hard evidence for the others, or
`onnx` where the user asks for a network of their own.
"""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import numpy as np

from pipeline.base.config import Masks
from pipeline.base.errors import InputError
from pipeline.base.files import write_json
from pipeline.base.images import in_rows, read_exr, read_png, to_srgb8, write_png
from pipeline.geometry.cameras import Rig, load_cameras
from pipeline.masks.agreement import LEAST_AGREEMENT, agreement
from pipeline.masks.automatic import plane_masks
from pipeline.masks.facts import MaskFacts
from pipeline.masks.network import network_masks
from pipeline.masks.sphere import in_a_sphere_that_holds

USUAL_AGREEMENT = 0.85  # mean agreement below which automatic masks are doubtful
# masks whose rim is white to this part, and which are not white all over, are the wrong way round
EXCHANGED, ALL_WHITE = 0.9, 0.98
AXES_MISS = 0.25  # radii by which the cameras' axes may miss the object without a word
LOOK = (
    "look at masks/overlay.jpg; one corrected mask in the scene's folder masks/ mends the others "
    "too"
)
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
    return masks, {"why": "masks or alpha came with the photos", "given": sorted(masks)}


MASKERS = {"given": given_masks, "plane": plane_masks, "onnx": network_masks}


def choose(poses: Path, rig: Rig, settings: Masks) -> str:
    """The method's name in MASKERS."""
    if settings.method != "auto":
        return settings.method
    every = all((poses / "masks" / f"{v.name}.png").exists() for v in rig.views)
    return "given" if every else "plane"


def overlay(poses: Path, rig: Rig, masks: dict, height: int = 200, limit: int = 36) -> np.ndarray:
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
    return in_rows(tiles)


def _rim(mask: np.ndarray) -> np.ndarray:
    """The outermost pixels of a mask (h, w)."""
    return np.concatenate([mask[0], mask[-1], mask[:, 0], mask[:, -1]])


def check(masks: dict, method: str) -> None:
    """Raises InputError when the masks cannot be of use."""
    area = {name: float(m.mean()) for name, m in masks.items()}
    black = [name for name, a in area.items() if a == 0]
    if method == "given" and black:
        raise InputError(
            f"the mask of '{black[0]}' is all black", "masks", "paint the object white there"
        )

    rim = float(np.median([_rim(m).mean() for m in masks.values()]))
    if method == "given" and rim > EXCHANGED and np.median(list(area.values())) < ALL_WHITE:
        raise InputError(
            f"white surrounds black: {100 * rim:.0f} % of the photos' rims are white",
            "masks",
            "are black and white exchanged? White is the object",
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


def said_of_agreement(confidence: dict, method: str) -> list[str]:
    """Warnings of masks that contradict each other; confidence: of `agreement`, without the views
    in which something hides the object.
    """
    out = []
    share = {name: c["confidence"] for name, c in confidence.items()}
    unsure = [name for name, c in share.items() if c < LEAST_AGREEMENT]
    if unsure:
        out.append(
            f"masks that do not agree with the others and will not carve: {len(unsure)} of "
            f"{len(share)} ({', '.join(unsure[:8])})"
        )

    mean = float(np.mean(list(share.values()))) if share else 1.0
    if method != "given" and mean < USUAL_AGREEMENT:
        out.append(
            f"the masks of the photos agree with each other by {100 * mean:.0f} % only (above "
            f"{100 * USUAL_AGREEMENT:.0f} % is usual): {LOOK}"
        )
    return out


def said_of_things(facts: dict) -> list[str]:
    """Warnings of what was left out and of cameras that look elsewhere; facts: of a masker."""
    out = []
    others = facts.get("others", [])
    if others:
        count = (
            "one other thing stands" if len(others) == 1 else f"{len(others)} other things stand"
        )
        where = ", ".join(
            f"{100 * o['size']:.0f} % as long as the object at {o['distance']:.1f} of its lengths"
            for o in others[:4]
        )
        out.append(
            f"{count} beside the object, left out ({where}): the object is what the middles of the "
            "photos show; set masks.parts: all if the rest belongs to it"
        )

    hidden_in = facts.get("hidden_in", [])
    if hidden_in:
        out.append(
            "photos in which another thing stands before the object, whose masks will not carve: "
            f"{len(hidden_in)} ({', '.join(hidden_in[:8])})"
        )

    miss = facts.get("axes_miss_by", 0.0)
    if miss > AXES_MISS:
        out.append(
            "the photos' middles do not show what was taken for the object (they miss it by "
            f"{100 * miss:.0f} % of its radius in the median): {LOOK}"
        )
    if "larger_than_points" in facts:
        by = facts["larger_than_points"]
        out.append(
            f"the object is {by:.1f} times as large as its matched points say, and so is the asset "
            f"where poses.object_size is given: to have that size, give {1 / by:.2f} of it"
        )
    if facts.get("sphere_widened", 1.0) is None:
        out.append(f"what was taken for the object ends nowhere near it: {LOOK}")
    return out


def make_masks(poses: Path, out: Path, settings: Masks, threads: int) -> dict:
    """Write masks/<name>.png, given.json (`MaskFacts`), confidence.json and overlay.jpg into `out`;
    returns metrics. Photos that are kept for scoring have no part in it.
    """
    rig = load_cameras(poses / "cameras.json").training()
    method = choose(poses, rig, settings)
    make = lambda scene: MASKERS[method](poses, scene, settings, threads)
    rig, (masks, facts) = in_a_sphere_that_holds(rig, make)
    if (facts["sphere_widened"] or 1.0) > 1:
        by = facts["sphere_widened"]
        facts["why"] += f"; in a sphere {by:.1f} times that of the matched points, which cut them"

    confidence = agreement(rig, masks)
    hidden_in = facts.get("hidden_in", [])
    for name in hidden_in:
        confidence[name]["carve"] = False

    whole = {name: c for name, c in confidence.items() if name not in hidden_in}
    check(masks, method)
    warnings = said_of_agreement(whole, method) + said_of_things(facts)
    for text in warnings:
        print(f"warning: {text}", file=sys.stderr)

    (out / "masks").mkdir()
    for v in rig.views:
        write_png(out / "masks" / f"{v.name}.png", masks[v.name] * np.uint8(255))
    carving = tuple(name for name, c in confidence.items() if c["carve"])
    given = tuple(facts.get("given", []))
    MaskFacts(method == "given", given, carving, tuple(rig.center), rig.radius).save(out)
    write_json(out / "confidence.json", confidence)
    write_png(out / "overlay.jpg", overlay(poses, rig, masks))

    return {
        "method": method,
        "given": [],
        "area_share": float(np.mean([m.mean() for m in masks.values()])),
        "warnings": warnings,
        "mean_confidence": float(np.mean([c["confidence"] for c in confidence.values()])),
    } | facts
