"""A small ray caster for the suite's lights: boxes and glowing rectangles around the object.

Light that falls on a wall is summed over the rectangles without shadows; all further bounces are
the constant of the integrating sphere, flux albedo / (1 - albedo) / area. Frame: Y-up, the object
at the origin. Nothing here is shared with the rooms that the priors were trained on, which Mitsuba
path-traces (pipeline/prior/training/rooms.py).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

SPLIT = 6  # parts along a side of a rectangle that it is summed by
NEAREST = 1e-3


@dataclass
class Box:
    """low, high (3,): corners; color(points (n, 3)) -> albedo (n, 3). `inside`: a room that is seen
    from within.
    """

    low: np.ndarray
    high: np.ndarray
    color: Callable[[np.ndarray], np.ndarray]
    inside: bool = False

    def meet(self, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Distances (n,) from the origin along unit directions (n, 3), infinite where there is no
        meeting, and normals (n, 3) towards the ray.
        """
        with np.errstate(divide="ignore"):
            one, two = self.low / directions, self.high / directions
        near, far = np.minimum(one, two), np.maximum(one, two)
        enter, leave = near.max(1), far.min(1)
        if self.inside:
            distance, axis = leave, far.argmin(1)
        else:
            met = (enter <= leave) & (enter > NEAREST)
            distance, axis = np.where(met, enter, np.inf), near.argmax(1)
        return distance, -np.sign(directions) * np.eye(3)[axis]


@dataclass
class Glow:
    """A rectangle of corner, sides a and b (3,) that glows on the side of a x b;
    radiance(directions (n, 3), s (n,), t (n,)) -> (n, 3), s and t along a and b in [0, 1].
    """

    corner: np.ndarray
    a: np.ndarray
    b: np.ndarray
    radiance: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]

    @property
    def normal(self) -> np.ndarray:
        out = np.cross(self.a, self.b)
        return out / np.linalg.norm(out)

    @property
    def area(self) -> float:
        return float(np.linalg.norm(np.cross(self.a, self.b)))

    def meet(self, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Distances (n,) as for a box, and s, t (n,)."""
        facing = directions @ self.normal
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = (self.corner @ self.normal) / facing
            offset = directions * distance[:, None] - self.corner
        s = offset @ self.a / (self.a @ self.a)
        t = offset @ self.b / (self.b @ self.b)
        met = (
            (facing < 0) & (distance > NEAREST) & (np.abs(s - 0.5) < 0.5) & (np.abs(t - 0.5) < 0.5)
        )
        return np.where(met, distance, np.inf), s, t

    def parts(self) -> tuple[np.ndarray, np.ndarray]:
        """Centres (k, 3) of its parts and their radiance (k, 3) as seen from the origin."""
        share = (np.arange(SPLIT) + 0.5) / SPLIT
        s, t = (x.ravel() for x in np.meshgrid(share, share))
        points = self.corner + s[:, None] * self.a + t[:, None] * self.b
        toward = points / np.linalg.norm(points, axis=1, keepdims=True)
        return points, self.radiance(toward, s, t)


@dataclass
class World:
    """What surrounds the object. beyond(directions (n, 3)) -> radiance (n, 3) where nothing is met;
    sun: direction (3,) and irradiance (3,) across it, or None; ambient: irradiance (3,) from
    everywhere else.
    """

    boxes: list[Box]
    glows: list[Glow] = field(default_factory=list)
    beyond: Callable[[np.ndarray], np.ndarray] = np.zeros_like
    sun: tuple[np.ndarray, np.ndarray] | None = None
    ambient: np.ndarray = field(default_factory=lambda: np.zeros(3))

    def irradiance(self, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
        """(n, 3) at points with unit normals (n, 3)."""
        out = np.broadcast_to(self.ambient, points.shape).copy()
        if self.sun is not None:
            direction, across = self.sun
            out += np.maximum(normals @ direction, 0)[:, None] * across
        for glow in self.glows:
            centres, radiance = glow.parts()
            for centre, brightness in zip(centres, radiance):
                to = centre - points
                squared = np.maximum((to**2).sum(1), 0.04)
                here = np.maximum((to * normals).sum(1), 0)
                there = np.maximum(-(to @ glow.normal), 0)
                form = here * there / squared**2 * glow.area / len(centres)
                out += form[:, None] * brightness
        return out

    def seen(self, directions: np.ndarray) -> np.ndarray:
        """Radiance (n, 3) that arrives at the origin from unit directions (n, 3)."""
        out = self.beyond(directions)
        depth = np.full(len(directions), np.inf)
        for box in self.boxes:
            distance, normal = box.meet(directions)
            nearer = distance < depth
            points = directions[nearer] * distance[nearer, None]
            falls = self.irradiance(points, normal[nearer])
            out[nearer] = box.color(points) * falls / np.pi
            depth = np.minimum(depth, distance)
        for glow in self.glows:
            distance, s, t = glow.meet(directions)
            nearer = distance < depth + NEAREST
            out[nearer] = glow.radiance(directions[nearer], s[nearer], t[nearer])
            depth = np.where(nearer, distance, depth)
        return out


def bounced(glows: list[Glow], size: np.ndarray, albedo: np.ndarray) -> np.ndarray:
    """Irradiance (3,) of all but the first bounce in a closed room of this size (3,)."""
    flux = sum(np.pi * glow.area * glow.parts()[1].mean(0) for glow in glows)
    area = 2 * (size[0] * size[1] + size[1] * size[2] + size[2] * size[0])
    return flux * albedo / (1 - albedo) / area
