"""What may be wrong with photos. Every function takes a scene's linear photos (n, h, w, 3), as they
were before clipping and rounding, where they show the object (n, h, w), how much is wrong, and a
generator; it returns the spoilt photos. At 0 nothing changes.
"""

from __future__ import annotations

import io

import numpy as np
from PIL import Image
from scipy import ndimage

LOSSLESS = 100  # quality at which no JPEG is made


def exposure_jitter(photos: np.ndarray, inside: np.ndarray, stops: float, rng) -> np.ndarray:
    """Every photo brighter or darker, by `stops` on average (standard deviation)."""
    return photos * 2 ** (stops * rng.normal(size=(len(photos), 1, 1, 1)))


def white_balance_jitter(photos: np.ndarray, inside: np.ndarray, spread: float, rng) -> np.ndarray:
    """Every photo's channels times factors whose logs have this spread and sum 0."""
    logs = rng.normal(size=(len(photos), 1, 1, 3))
    logs -= logs.mean(-1, keepdims=True)
    return photos * np.exp(spread * np.sqrt(1.5) * logs)


def blur(photos: np.ndarray, inside: np.ndarray, sigma: float, rng) -> np.ndarray:
    """Out of focus: a Gaussian of `sigma` pixels over object and background."""
    return ndimage.gaussian_filter(photos, (0, sigma, sigma, 0))


def motion_blur(photos: np.ndarray, inside: np.ndarray, length: float, rng) -> np.ndarray:
    """Every photo smeared over `length` pixels in a direction of its own."""
    if length == 0:
        return photos
    steps = np.linspace(-0.5, 0.5, 2 * int(np.ceil(length)) + 1) * length
    out = []
    for photo, angle in zip(photos, rng.uniform(0, np.pi, len(photos))):
        along = np.array([np.sin(angle), np.cos(angle), 0])
        moved = [ndimage.shift(photo, step * along, order=1, mode="nearest") for step in steps]
        out.append(np.mean(moved, axis=0))
    return np.array(out)


def noise(photos: np.ndarray, inside: np.ndarray, at_white: float, rng) -> np.ndarray:
    """Photon noise: a standard deviation of `at_white` where the photo is white, falling with the
    square root of the light; channels are independent.
    """
    deviation = at_white * np.sqrt(np.maximum(photos, 0))
    return np.maximum(photos + deviation * rng.normal(size=photos.shape), 0)


def clipping_gain(photos: np.ndarray, inside: np.ndarray, share: float) -> float:
    """Exposure at which this share of the object's pixels is white in some channel."""
    if share == 0:
        return 1.0
    return float(1 / np.quantile(photos[inside].max(-1), 1 - share))


def underexposure(photos: np.ndarray, inside: np.ndarray, stops: float) -> float:
    """Exposure `stops` lower, so that few of the 8 bits are left."""
    return 2.0**-stops


def jpeg(picture: np.ndarray, quality: float) -> np.ndarray:
    """An 8-bit picture (h, w, 3) after JPEG of this quality, chroma at half the resolution."""
    if quality >= LOSSLESS:
        return picture
    file = io.BytesIO()
    Image.fromarray(picture).save(file, "JPEG", quality=int(quality), subsampling=2)
    return np.asarray(Image.open(file))
