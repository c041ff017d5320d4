"""New views of a known light: turned, mirrored, seen from a moved viewpoint, with another white
balance and contrast.

A hundred maps are few. Seen from a point o inside the unit sphere on which the scene is painted,
direction d shows what lies at the sphere's point o + t d: walls come nearer, horizons sink,
radiance along rays stays. Half of all draws stay unmoved, so that peaks keep their exact size.
"""

from __future__ import annotations

import cv2
import numpy as np

from pipeline.render.envmap import directions, mirror, resample_area, uv_from_direction, yaw_roll

MOVE_ALONG = 0.45  # largest horizontal move, in radii
MOVE_UP = 0.15  # largest vertical one
WHITE_BALANCE = 0.06  # deviation of log gain per channel
CONTRAST = 0.06  # deviation of log gamma


def moved(env: np.ndarray, origin: np.ndarray, yaw: float) -> np.ndarray:
    """What is seen from `origin` (3,), |origin| < 1, turned by `yaw` radians; env (h, w, 3) and
    result on the same grid.
    """
    h, w = env.shape[:2]
    cosine = np.cos(yaw)
    sine = np.sin(yaw)
    d = directions(h, w) @ np.array([[cosine, 0, -sine], [0, 1, 0], [sine, 0, cosine]])
    along = d @ origin
    distance = -along + np.sqrt(along**2 + 1 - origin @ origin)
    uv = uv_from_direction(origin + distance[..., None] * d).astype(np.float32)

    padded = np.concatenate([env[:, -1:], env, env[:, :1]], 1)
    return cv2.remap(
        padded,
        uv[..., 0] * w + 0.5,
        uv[..., 1] * h - 0.5,
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
    if rng.random() < 0.5:
        env = mirror(env)

    env = resample_area(env, height, 2 * height)
    gain = np.exp(WHITE_BALANCE * rng.normal(size=3))
    gamma = np.exp(CONTRAST * rng.normal())
    return (gain * np.maximum(env, 0) ** gamma).astype(np.float32)
