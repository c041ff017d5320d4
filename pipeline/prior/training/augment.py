"""New views of a known light: turned, mirrored, seen from a moved viewpoint, with another white
balance and contrast.

A hundred maps are few. Seen from a point o inside the unit sphere on which the scene is painted,
direction d shows what lies at the sphere's point o + t d: walls come nearer, horizons sink,
radiance along rays stays. Half of all draws stay unmoved, so that peaks keep their exact size.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from pipeline.render.envmap import directions, mirror, resample_area, uv_from_direction, yaw_roll

MOVE_ALONG = 0.45  # largest horizontal move, in radii
MOVE_UP = 0.15  # largest vertical one
WHITE_BALANCE = 0.06  # deviation of log gain per channel
CONTRAST = 0.06  # deviation of log gamma
MOST_CONTRAST = 0.5  # log gamma at most


def moved(
    env: np.ndarray, origin: np.ndarray, yaw: float, stretch: Sequence[float] = (0, 0)
) -> np.ndarray:
    """What is seen from `origin` (3,), |origin| < 1, turned by `yaw` radians; env (h, w, 3) and
    result on the same grid. stretch: what is looked up at v, the latitude's place from the top in
    [0, 1], lies at v + s_0 sin(2 pi v) / 2 pi + s_1 sin(pi v) / pi.
    """
    h, w = env.shape[:2]
    cosine = np.cos(yaw)
    sine = np.sin(yaw)
    d = directions(h, w) @ np.array([[cosine, 0, -sine], [0, 1, 0], [sine, 0, cosine]])
    along = d @ origin
    distance = -along + np.sqrt(along**2 + 1 - origin @ origin)
    uv = uv_from_direction(origin + distance[..., None] * d)
    v = uv[..., 1]
    if any(stretch):
        v = v + stretch[0] * np.sin(2 * np.pi * v) / (2 * np.pi)
        v = np.clip(v + stretch[1] * np.sin(np.pi * uv[..., 1]) / np.pi, 0, 1)

    padded = np.concatenate([env[:, -1:], env, env[:, :1]], 1)
    return cv2.remap(
        padded,
        (uv[..., 0] * w + 0.5).astype(np.float32),
        (v * h - 0.5).astype(np.float32),
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_REPLICATE,
    )


def draw_view(env: np.ndarray, height: int, rng: np.random.Generator) -> np.ndarray:
    """A random view of radiance env (H, 2H, 3), H >= height, as (height, 2 height, 3)."""
    if rng.random() < 0.5:
        env = yaw_roll(env, int(rng.integers(env.shape[1])))
    else:
        angle = rng.uniform(0, 2 * np.pi)
        radius = MOVE_ALONG * np.sqrt(rng.random())
        up = rng.uniform(-MOVE_UP, MOVE_UP)
        origin = np.array([radius * np.cos(angle), up, radius * np.sin(angle)])
        env = moved(env, origin, rng.uniform(0, 2 * np.pi))
    env = resample_area(random_mirror(env, rng), height, 2 * height)
    return coloured(env, WHITE_BALANCE, CONTRAST, rng)


def random_mirror(env: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Mirrored half of the time."""
    return mirror(env) if rng.random() < 0.5 else env


def coloured(
    env: np.ndarray, white_balance: float, contrast: float, rng: np.random.Generator
) -> np.ndarray:
    """In another white balance and contrast: deviations of log gain per channel and of log
    gamma.
    """
    gain = np.exp(white_balance * rng.normal(size=3))
    gamma = np.exp(np.clip(contrast * rng.normal(), -MOST_CONTRAST, MOST_CONTRAST))
    return (gain * np.maximum(env, 0) ** gamma).astype(np.float32)
