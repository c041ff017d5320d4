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
CALM = 128  # of a map's side: distances to the groups are averaged over as much


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
    """Region of every texel (size, size) by a map of base colour: the nearest centre's, distances
    averaged over neighbours and lone texels voted down, for a map's noise is no material.
    """
    colour = cv2.resize(base_color, (size, size), interpolation=cv2.INTER_AREA)
    far = ((features(colour)[:, :, None] - centers) ** 2).sum(-1)
    far = cv2.GaussianBlur(far, (0, 0), max(size / CALM, 0.3)).reshape(far.shape)
    label = far.argmin(-1).astype(np.uint8)
    return cv2.medianBlur(label, 5) if size >= 32 else label
