"""What may be wrong with given cameras. Every function takes the content of transforms.json, how
much is wrong, and a generator; it returns the spoilt content. At 0 nothing changes.
"""

from __future__ import annotations

import copy

import numpy as np
from scipy.spatial.transform import Rotation


def pose_noise(content: dict, degrees: float, rng) -> dict:
    """Every camera moved on its sphere about the origin and turned about its own centre, each by a
    rotation vector with components of this standard deviation.
    """
    out = copy.deepcopy(content)
    for frame in out["frames"]:
        matrix = np.array(frame["transform_matrix"])
        moved, turned = Rotation.from_rotvec(np.radians(degrees) * rng.normal(size=(2, 3)))
        matrix[:3] = moved.as_matrix() @ matrix[:3]
        matrix[:3, :3] = turned.as_matrix() @ matrix[:3, :3]
        frame["transform_matrix"] = matrix.tolist()
    return out


def focal_error(content: dict, share: float, rng) -> dict:
    """A focal length that is too long by this share."""
    out = copy.deepcopy(content)
    half = 0.5 * content["camera_angle_x"]
    out["camera_angle_x"] = float(2 * np.arctan(np.tan(half) / (1 + share)))
    return out


def baseline_gap(content: dict, degrees: float, rng) -> dict:
    """No camera within a sector of this width around the object; three are left at least."""
    out = copy.deepcopy(content)
    centre = rng.uniform(0, 360)

    def away(frame: dict) -> float:
        """Degrees between the frame's azimuth and the sector's middle."""
        x, y = np.array(frame["transform_matrix"])[:2, 3]
        return abs((np.degrees(np.arctan2(y, x)) - centre + 180) % 360 - 180)

    farthest = sorted(out["frames"], key=away, reverse=True)
    kept = [frame for k, frame in enumerate(farthest) if k < 3 or away(frame) >= degrees / 2]
    out["frames"] = [frame for frame in out["frames"] if frame in kept]
    return out
