"""The suite's lights: sunny and cloudy streets, rooms with windows, studios with soft boxes.

None was seen in training, by seed and by generator. The priors' procedural lights are Mitsuba's
sky model (Wilkie et al. 2021) over filtered noise, and path-traced rooms; these are the sky of the
standard CIE S 011 (ISO 15469:2004) and ray-cast boxes (raycast.py), with random numbers of their
own. Nothing of pipeline/prior/training is imported.

Arrays (h, 2h, 3), relative radiance in the library's frame (pipeline/render/envmap.py).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from benchmarks.suite.raycast import Box, Glow, World, bounced
from benchmarks.suite.solid_noise import SolidNoise
from pipeline.base.errors import InputError, nearest
from pipeline.render.envmap import directions, resample_area, solid_angles

SEED = 20_230_917  # of the suite: numpy's generator starts from [SEED, kind, number]
# Parameters a to e of the standard skies by number (ISO 15469:2004, table 1).
SKIES = {
    1: (4.0, -0.70, 0.0, -1.0, 0.0),  # overcast
    7: (0.0, -1.0, 5.0, -2.5, 0.30),  # partly cloudy, brighter around the sun
    12: (-1.0, -0.32, 10.0, -3.0, 0.45),  # clear, clean air
    13: (-1.0, -0.32, 16.0, -3.0, 0.30),  # clear, polluted air
}
BLUE = np.array([0.42, 0.72, 1.45])
WHITE = np.array([1.0, 1.0, 1.02])
SUN_WIDTH = np.radians(1.0)  # of the Gaussian that the disc becomes in the map
FINER = 2  # directions per pixel and side that a map is averaged from


def unit(v) -> np.ndarray:
    """v (3,) at length 1."""
    return np.asarray(v, float) / np.linalg.norm(v)


def at_angles(elevation: float, azimuth: float) -> np.ndarray:
    """Unit vector (3,) of angles in degrees; azimuth 0 is +Z."""
    e, a = np.radians([elevation, azimuth])
    return np.array([np.cos(e) * np.sin(a), np.sin(e), np.cos(e) * np.cos(a)])


def cie_sky(kind: int, sun: np.ndarray, d: np.ndarray) -> np.ndarray:
    """Luminance (n,) in directions d (n, 3), relative to the zenith's: f(chi) phi(Z) / (f(Z_s)
    phi(0)), phi(Z) = 1 + a exp(b / cos Z), f(chi) = 1 + c (exp(d chi) - exp(d pi / 2)) + e cos^2
    chi (ISO 15469:2004, eqs. 1 to 6).
    """
    a, b, c, slope, e = SKIES[kind]
    up = np.maximum(d[:, 1], 0.02)
    graded = lambda cosine: 1 + a * np.exp(b / cosine)

    def scattered(cosine):
        angle = np.arccos(np.clip(cosine, -1, 1))
        return 1 + c * (np.exp(slope * angle) - np.exp(slope * np.pi / 2)) + e * cosine**2

    return scattered(d @ sun) * graded(up) / (scattered(sun[1]) * graded(1.0))


def sky(kind: int, sun: np.ndarray, clouds: Callable[[np.ndarray], np.ndarray]):
    """A function directions -> radiance (n, 3): the standard sky, blue but near the sun and the
    horizon, with a share `clouds` of white.
    """
    blueness = {1: 0.0, 7: 0.6, 12: 1.0, 13: 0.7}[kind]

    def radiance(d: np.ndarray) -> np.ndarray:
        white = np.clip(1 - blueness * (1 - np.exp(-4 * np.maximum(d[:, 1], 0))), 0, 1)
        white = np.maximum(white, np.exp(-4 * (1 - d @ sun)))[:, None]
        clear = cie_sky(kind, sun, d)[:, None] * (white * WHITE + (1 - white) * BLUE)
        share = clouds(d)[:, None]
        return (1 - share) * clear + share * 1.6 * WHITE

    return radiance


def lumps(seed: int, cover: float, sharp: float) -> Callable[[np.ndarray], np.ndarray]:
    """Clouds on a plane overhead: share (n,) in directions (n, 3), `cover` of it on average near
    .5.
    """
    noise = SolidNoise(seed)

    def share(d: np.ndarray) -> np.ndarray:
        plane = d / np.maximum(d[:, 1:2], 0.12) * [1, 0, 1]
        return 1 / (1 + np.exp(-sharp * (noise.fractal(0.8 * plane, 5) + cover - 0.5)))

    return share


def painted(rng: np.random.Generator, low: float, high: float, scale: float):
    """Albedo of walls and ground: a colour, tiled and mottled."""
    noise = SolidNoise(int(rng.integers(1 << 30)))
    color = rng.uniform(low, high) * np.exp(rng.normal(0, 0.1, 3))
    contrast = rng.uniform(0.1, 0.5)

    def albedo(points: np.ndarray) -> np.ndarray:
        tile = (np.floor(points * scale).sum(1) % 2) - 0.5
        shade = np.exp(contrast * (tile * 0.6 + noise.fractal(points * scale * 0.7)))
        return np.clip(color * shade[:, None], 0.01, 0.9)

    return albedo


def street(rng: np.random.Generator) -> list[Box]:
    """Ground below the object, and houses around it."""
    far = 400.0
    boxes = [
        Box(np.array([-far, -3.0, -far]), np.array([far, -1.4, far]), painted(rng, 0.1, 0.4, 0.5))
    ]
    for _ in range(rng.integers(5, 14)):
        away, azimuth = rng.uniform(9, 40), rng.uniform(0, 2 * np.pi)
        middle = away * np.array([np.sin(azimuth), 0, np.cos(azimuth)])
        half = rng.uniform([1.5, 0, 1.5], [5, 0, 5])
        low, high = middle - half, middle + half
        low[1], high[1] = -1.4, rng.uniform(1, 14)
        if np.hypot(*np.clip(0, low, high)[[0, 2]]) > 3:  # not around the object
            boxes.append(Box(low, high, painted(rng, 0.1, 0.7, 0.7)))
    return boxes


def outdoors(rng: np.random.Generator, h: int, kind: int, elevation: float, strength: float, cover):
    """A street below a standard sky; strength: the sun's irradiance across it against the sky's on
    the ground.
    """
    sun = at_angles(elevation, rng.uniform(0, 360))
    above = sky(kind, sun, lumps(int(rng.integers(1 << 30)), *cover))
    d = directions(32, 64).reshape(-1, 3)
    falling = above(d) * np.maximum(d[:, 1:2], 0) * solid_angles(32, 64).reshape(-1, 1)
    diffuse = falling.sum(0)
    across = strength * diffuse.mean() * np.array([1.1, 1.0, 0.85])
    world = World(street(rng), beyond=above, sun=(sun, across), ambient=0.5 * diffuse)
    return mapped(world, h) + sun_disc(sun, across, h)


def sun_disc(sun: np.ndarray, across: np.ndarray, h: int) -> np.ndarray:
    """The sun (h, 2h, 3) of irradiance `across` (3,), blurred to SUN_WIDTH."""
    blurred = np.exp((directions(4 * h, 8 * h) @ sun - 1) / SUN_WIDTH**2)
    flux = (blurred * solid_angles(4 * h, 8 * h)).sum()
    return resample_area((blurred / flux)[..., None] * across, h, 2 * h)


def mapped(world: World, h: int) -> np.ndarray:
    """What the world shows, (h, 2h, 3), averaged from FINER directions per pixel and side."""
    fine = FINER * h
    seen = world.seen(directions(fine, 2 * fine).reshape(-1, 3))
    return resample_area(seen.reshape(fine, 2 * fine, 3), h, 2 * h)


def sunny(rng: np.random.Generator, h: int) -> np.ndarray:
    """A street under a clear sky with its sun."""
    kind = int(rng.choice([12, 13]))
    return outdoors(rng, h, kind, rng.uniform(15, 60), rng.uniform(2.5, 6), (0.05, 12.0))


def cloudy(rng: np.random.Generator, h: int) -> np.ndarray:
    """A street under an overcast or broken sky, the sun behind clouds."""
    kind = int(rng.choice([1, 7]))
    return outdoors(rng, h, kind, rng.uniform(25, 60), rng.uniform(0, 0.25), (0.7, 5.0))


def window(rng: np.random.Generator, low: np.ndarray, high: np.ndarray, wall: int, view) -> Glow:
    """A window in one of the room's four walls, that shows `view` times its brightness."""
    axis, end = (0, 2)[wall % 2], wall // 2
    along = 2 - axis
    width = rng.uniform(1.0, 0.8 * (high[along] - low[along]))
    start = rng.uniform(low[along] + 0.1, high[along] - width - 0.1)
    bottom = rng.uniform(-0.5, 0.2)
    corner = np.zeros(3)
    corner[axis] = high[axis] - 0.01 if end else low[axis] + 0.01
    corner[along], corner[1] = start, bottom
    a, b = np.eye(3)[along] * width, np.array([0, rng.uniform(1.0, high[1] - bottom - 0.2), 0])
    if np.cross(a, b) @ np.eye(3)[axis] * (1 - 2 * end) < 0:
        corner, a = corner + a, -a
    panes = rng.integers(1, 4)
    brightness = rng.uniform(20, 60)

    def radiance(d: np.ndarray, s: np.ndarray, t: np.ndarray) -> np.ndarray:
        bar = (np.abs((s * panes) % 1 - 0.5) > 0.46) | (np.abs(t - 0.55) < 0.02)
        return np.where(bar[:, None], 0.3, brightness * view(d))

    return Glow(corner, a, b, radiance)


def even_glow(color: np.ndarray, fall: float = 0.0):
    """Radiance of a lamp or a soft box, which falls off from its middle by the share `fall`."""

    def radiance(d: np.ndarray, s: np.ndarray, t: np.ndarray) -> np.ndarray:
        away = (2 * s - 1) ** 2 + (2 * t - 1) ** 2
        return np.exp(-1.5 * fall * away)[:, None] * color

    return radiance


def room(rng: np.random.Generator, h: int) -> np.ndarray:
    """A room with one to three windows, now and then a ceiling lamp, and furniture."""
    half = rng.uniform([1.8, 0, 1.8], [4.0, 0, 4.0])
    low, high = -half, half.copy()
    low[1], high[1] = -rng.uniform(0.9, 1.3), rng.uniform(1.3, 2.2)
    off = rng.uniform(-0.4, 0.4, 3) * [half[0], 0, half[2]]
    low, high = low + off, high + off

    above = sky(7, at_angles(40, rng.uniform(0, 360)), lumps(int(rng.integers(1 << 30)), 0.4, 6.0))
    ground = rng.uniform(0.1, 0.4) * np.array([1.0, 1.0, 0.8])
    view = lambda d: np.where(d[:, 1:2] > 0.02, above(d), ground)
    walls = rng.permutation(4)[: rng.integers(1, 4)]
    glows = [window(rng, low, high, int(wall), view) for wall in walls]
    if rng.random() < 0.6:
        warm = np.array([1.35, 1.0, 0.55]) * rng.uniform(30, 90)
        corner = np.array([rng.uniform(-0.8, 0.3), high[1] - 0.02, rng.uniform(-0.8, 0.3)])
        glows.append(Glow(corner, np.array([0.5, 0, 0]), np.array([0, 0, 0.5]), even_glow(warm)))

    boxes = [Box(low, high, painted(rng, 0.3, 0.75, 1.2), inside=True)]
    for _ in range(rng.integers(2, 6)):
        size = rng.uniform([0.3, 0.3, 0.3], [1.2, 1.4, 1.2])
        azimuth, away = rng.uniform(0, 2 * np.pi), rng.uniform(1.4, 3)
        corner = away * np.array([np.sin(azimuth), 0, np.cos(azimuth)]) - size / 2
        corner[1] = low[1]
        top = np.minimum(corner + size, high - 0.05)
        corner = np.maximum(corner, low + 0.05)
        if (top > corner).all() and np.hypot(*np.clip(0, corner, top)[[0, 2]]) > 0.8:
            boxes.append(Box(corner, top, painted(rng, 0.05, 0.6, 3.0)))
    ambient = bounced(glows, high - low, np.array([0.5, 0.48, 0.45]))
    return mapped(World(boxes, glows, ambient=ambient), h)


def soft_box(rng: np.random.Generator, direction: np.ndarray, distance: float, strength: float):
    """A rectangle that faces the object."""
    across = unit(np.cross([0, 1, 0], direction))
    upward = np.cross(direction, across)
    a, b = across * rng.uniform(0.4, 1.6), upward * rng.uniform(0.4, 1.6)
    if np.cross(a, b) @ direction > 0:
        a = -a
    corner = direction * distance - (a + b) / 2
    color = strength * np.exp(rng.normal(0, 0.06, 3))
    return Glow(corner, a, b, even_glow(color, rng.uniform(0, 1)))


def studio(rng: np.random.Generator, h: int) -> np.ndarray:
    """Two to four soft boxes in a dark or a white hall."""
    dark = rng.random() < 0.6
    half = np.array([5.0, 2.6, 5.0])
    low, high = half * [-1, -0.5, -1], half
    tone = (0.04, 0.12) if dark else (0.5, 0.8)
    glows = [
        soft_box(
            rng,
            at_angles(rng.uniform(5, 55), azimuth + rng.uniform(-25, 25)),
            rng.uniform(1.6, 2.2),
            rng.uniform(4, 30),
        )
        for azimuth in rng.uniform(0, 360) + np.linspace(0, 360, rng.integers(3, 6))[:-1]
    ]
    boxes = [Box(low, high, painted(rng, *tone, 0.4), inside=True)]
    ambient = bounced(glows, high - low, np.full(3, 0.08 if dark else 0.6))
    return mapped(World(boxes, glows, ambient=ambient), h)


KINDS = {"sunny": sunny, "cloudy": cloudy, "room": room, "studio": studio}
INDOOR = ("room", "studio")
LABELS = {"sunny": "outdoor", "cloudy": "outdoor", "room": "indoor", "studio": "studio"}


def make_light(name: str, h: int = 128) -> np.ndarray:
    """Light KIND_NUMBER, for example room_3, (h, 2h, 3) float32, solid-angle mean 1; it depends on
    its name alone. Raises InputError for an unknown name.
    """
    kind, _, number = name.rpartition("_")
    if kind not in KINDS or not number.isdigit():
        raise InputError(
            f"there is no light '{name}'", "suite", nearest(kind, KINDS) + " (KIND_NUMBER)"
        )
    rng = np.random.default_rng([SEED, list(KINDS).index(kind), int(number)])
    light = KINDS[kind](rng, h)
    weight = solid_angles(h, 2 * h)[..., None] / (4 * np.pi)
    return (light / (light * weight).sum((0, 1)).mean()).astype(np.float32)
