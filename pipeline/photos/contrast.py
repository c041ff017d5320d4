"""Photos in which every neighbourhood's contrast is brought out, for features to be found.

SIFT keeps what stands out by a fixed step of brightness. So a thing in the dark, or in the shadow
of a bright photo, has few features as it was exposed.
"""

from __future__ import annotations

import cv2
import numpy as np

LIMIT = 3.0  # times the even histogram's height, to which a neighbourhood's is cut
TILES = 8, 8  # neighbourhoods along the sides


def brought_out(photo: np.ndarray) -> np.ndarray:
    """A photo (h, w, 3) uint8 in sRGB as a grey one (h, w) uint8, by contrast-limited adaptive
    histogram equalisation (Zuiderveld, Graphics Gems IV, 1994).
    """
    grey = cv2.cvtColor(photo, cv2.COLOR_RGB2GRAY)
    return cv2.createCLAHE(LIMIT, TILES).apply(grey)
