"""Regions of like colour: the surface's points and texels in a few groups that share roughness,
metallic and mean colour.

Chromaticity tells materials apart better than brightness does, which carries the shading; so log
brightness counts less. The number of groups is the smallest that explains most of the spread
(Lloyd's k-means, scipy).
"""

from __future__ import annotations

import cv2
import numpy as np
from scipy.cluster.vq import kmeans2

BRIGHTNESS = 0.35  # weight of log brightness against log chromaticity
EXPLAINED = 0.85  # share of the spread at which no more groups are added, unless told
LARGEST = 6
# of a map's side: texels are averaged with others as near, and within as much of `features`; so
# many times
CALM, ALIKE, FILTERED = 128, 0.3, 2


def features(rgb: np.ndarray) -> np.ndarray:
    """(n, 3): two log chromaticities and weighted log brightness."""
    v = np.log(rgb + 0.02)
    mean = v.mean(-1)
    return np.stack([v[..., 0] - v[..., 1], v[..., 2] - v[..., 1], BRIGHTNESS * mean], -1)


def group(
    rgb: np.ndarray, share: float = EXPLAINED, seed: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """Labels (n,) of colours (n, 3) and the groups' centres in feature space; no more groups than
    explain `share` of the spread.
    """
    f = features(rgb)
    total = ((f - f.mean(0)) ** 2).sum()
    for count in range(1, LARGEST + 1):
        centers, label = kmeans2(f, count, seed=seed, minit="++")
        explained = 1 - ((f - centers[label]) ** 2).sum() / max(total, 1e-12)
        if explained > share or total / len(f) < 1e-3:
            break
    used, label = np.unique(label, return_inverse=True)
    return label, centers[used]


def texel_regions(base_color: np.ndarray, centers: np.ndarray, size: int) -> np.ndarray:
    """Region of every texel (size, size) by a map of base colour: the nearest centre's, after a
    bilateral filter (Tomasi and Manduchi 1998), for a map's noise is no material; lone texels are
    voted down.
    """
    colour = cv2.resize(base_color, (size, size), interpolation=cv2.INTER_AREA)
    calm: np.ndarray = features(colour).astype(np.float32)
    reach = max(size / CALM, 0.5)
    for _ in range(FILTERED):
        calm = np.asarray(cv2.bilateralFilter(calm, -1, ALIKE, reach))
    label = ((calm[:, :, None] - centers) ** 2).sum(-1).argmin(-1).astype(np.uint8)
    return cv2.medianBlur(label, 5) if size >= 32 else label
