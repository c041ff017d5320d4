"""Masks against the truth: what of the object they miss, and what they add to it."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from pipeline.base.images import read_png
from pipeline.geometry.cameras import View
from pipeline.geometry.mesh_io import Mesh
from pipeline.surface.preview import Silhouette


def mask_errors(masks: Path, truth: Mesh, views: Iterable[View]) -> dict[str, float]:
    """Of the masks that a stage wrote, by the silhouette of the true mesh in the true views (of the
    photos as the masks stage sees them, up to size): mean intersection over union, and the missed
    and the added pixels of all photos over the object's. Views without a mask do not count.

    Raises ValueError where no view has a mask.
    """
    covers = Silhouette(truth)
    iou, missed, added, object_pixels = [], 0, 0, 0
    for view in views:
        file = masks / f"{view.name}.png"
        if not file.exists():
            continue
        mask = read_png(file) > 127
        true = covers(view.at_size(mask.shape[1], mask.shape[0]))
        iou.append((mask & true).sum() / (mask | true).sum())
        missed += int((true & ~mask).sum())
        added += int((mask & ~true).sum())
        object_pixels += int(true.sum())
    if not iou:
        raise ValueError(f"no view of the truth has a mask in {masks}")
    return {
        "iou": float(np.mean(iou)),
        "missed": missed / object_pixels,
        "added": added / object_pixels,
    }
