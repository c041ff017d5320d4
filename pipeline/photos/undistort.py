"""Photos without their lens's distortion: what every later stage looks at."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from pipeline.base.images import read_exr, read_png, write_exr, write_png
from pipeline.base.progress import progress
from pipeline.geometry.cameras import View
from pipeline.photos.given_cameras import Lens


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
