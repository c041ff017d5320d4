"""Photos as features are sought in them: grey, every neighbourhood's contrast brought out.

SIFT keeps what stands out by a fixed step of brightness. So a thing in the dark, or in the shadow
of a bright photo, has few features as it was exposed.
"""

from __future__ import annotations

import cv2
import numpy as np
from PIL import Image

from pipeline.base.images import to_srgb8

LIMIT = 3.0  # times the even histogram's height, to which a neighbourhood's is cut
TILES = 8, 8  # neighbourhoods along the sides


def for_matching(photo: np.ndarray, most: int) -> Image.Image:
    """A photo (h, w, 3), linear, as a grey sRGB picture whose long side is at most `most` pixels,
    by contrast-limited adaptive histogram equalisation (Zuiderveld, Graphics Gems IV, 1994).
    """
    image = Image.fromarray(to_srgb8(photo)).convert("L")
    image.thumbnail((most, most), Image.Resampling.LANCZOS)
    return Image.fromarray(cv2.createCLAHE(LIMIT, TILES).apply(np.asarray(image)))
