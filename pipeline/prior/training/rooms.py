"""Random furnished rooms and product studios: indoor lights for the prior's training.

Walls, floor, furniture, pictures are diffuse rectangles; windows, ceiling panels, bulbs, shades,
screens, soft boxes emit. A rectangle is a corner and its sides a and b (3,); it faces a x b. Units:
metres. A map follows from its seed only while the order of the random numbers stays as it is.
"""

from __future__ import annotations

import numpy as np

from pipeline.prior.training.path_traced import FACES, Quads, bulb, glowing, trace


def warm(rng) -> np.ndarray:
    """Colour of a lamp, mean 1: between tungsten and daylight."""
    red = rng.uniform(0, 1)
    color = np.array([1 + 0.55 * red, 1, 1 - 0.65 * red])
    return color / color.mean()


def paint(rng, low: float, high: float, chroma: float) -> np.ndarray:
    """A reflectance (3,) below 0.9: mostly white, beige, wood and grey; three in ten a strong
    colour of deviation `chroma`.
    """
    tilt = rng.normal(0.35, 0.4) * np.array([0.25, 0, -0.4]) * min(1, 4 * chroma)
    color = tilt + (chroma if rng.random() < 0.3 else 0.15 * chroma) * rng.normal(size=3)
    return np.clip(rng.uniform(low, high) * np.exp(color), 0.01, 0.9)


def white_balanced(rng, env: np.ndarray) -> np.ndarray:
    """As a camera does: most of the mean colour (by geometric mean, so that lamps count little) is
    divided out.
    """
    tint = np.exp(np.log(env + 1e-6).mean((0, 1)))
    return env * (tint.mean() / tint) ** rng.uniform(0.1, 0.8)


def textured(rng, color, n: int, m: int, contrast: float) -> np.ndarray:
    """(n, m, 3): a colour modulated by noise, stripes or tiles."""
    field = rng.normal(size=(n, m))
    kind = rng.integers(0, 3)
    if kind == 1:
        field = np.broadcast_to(rng.normal(size=(n, 1)), (n, m))
    elif kind == 2:
        field = np.where((np.arange(n)[:, None] + np.arange(m)) % 2, 1.0, -1.0)
    return np.clip(color * np.exp(contrast * field)[..., None], 0.005, 0.92)


def _shell(rng, quads: Quads, size: np.ndarray) -> None:
    """Walls, floor and ceiling seen from inside."""
    wall = paint(rng, 0.08, 0.8, 0.3)
    chroma = rng.uniform(0.02, 0.2)
    for axis, end in FACES:
        u, v = [np.eye(3)[(axis + k) % 3] * size for k in (1, 2)]
        corner = np.eye(3)[axis] * size * end
        if axis == 1:
            tone = (0.2, 0.85, 0.05) if end else (0.03, 0.45, 0.3)
            color = textured(rng, paint(rng, *tone), 25, 25, rng.uniform(0.03, 0.5))
        else:
            tint = wall * np.exp(chroma * rng.normal(size=3))
            color = textured(rng, tint, 17, 17, rng.uniform(0, 0.4))
        quads.add(corner, *((v, u) if end else (u, v)), color)


def _on_wall(rng, size, width, height, bottom, gap):
    """A random upright rectangle `gap` in front of a wall, facing the room: corner, a, b."""
    axis = rng.choice([0, 2])
    end = rng.integers(0, 2)
    along = 2 - axis
    width = min(width, 0.9 * size[along])

    corner = np.zeros(3)
    corner[axis] = size[axis] - gap if end else gap
    corner[along] = rng.uniform(0, size[along] - width)
    corner[1] = bottom
    a = np.eye(3)[along] * width
    b = np.array([0, min(height, size[1] - bottom - 0.05), 0])

    inward = np.eye(3)[axis] * (-1 if end else 1)
    if np.cross(a, b) @ inward < 0:
        corner = corner + a
        a = -a
    return corner, a, b


def _window(rng, quads: Quads, size, sky: np.ndarray, brightness: float) -> dict:
    """A window: bright above, ground below, with bars in front. Returns the emitter."""
    corner, a, b = _on_wall(
        rng, size, rng.uniform(0.6, 3.5), rng.uniform(1, 2), rng.uniform(0, 1.1), 0.02
    )
    rows = np.linspace(0, 1, 9)[None, :, None]
    ground = sky.mean() * rng.uniform(0.05, 0.5) * paint(rng, 0.5, 0.9, 0.3)
    horizon = rng.uniform(0.1, 0.8)
    view = np.where(rows < horizon, ground, sky * (0.8 + 0.4 * rows))
    view = view * np.exp(0.35 * rng.normal(size=(9, 9, 1)))

    before_glass = 0.02 * (np.cross(a, b) / np.linalg.norm(np.cross(a, b)))
    frame = paint(rng, 0.05, 0.8, 0.05)
    for k in range(rng.integers(0, 4)):
        at = corner + a * (k + 1) / 4 + before_glass
        quads.add(at, 0.06 * a / np.linalg.norm(a), b, frame)
    if rng.random() < 0.5:
        at = corner + b * rng.uniform(0.3, 0.7) + before_glass
        quads.add(at, a, 0.06 * b / np.linalg.norm(b), frame)
    return glowing(corner, a, b, brightness * view)


def _lamps(rng, quads: Quads, size) -> list[dict]:
    """Ceiling panels, bulbs, shades and screens."""
    tint = warm(rng)
    makers = {"panel": _panel, "screen": _screen, "bulb": _bulb, "shade": _shade}
    out = []
    for _ in range(rng.integers(0, 4)):
        kind = rng.choice(["panel", "bulb", "bulb", "shade", "screen"])
        color = tint * np.exp(0.05 * rng.normal(size=3))
        out.append(makers[kind](rng, quads, size, color))
    return out


def _panel(rng, quads: Quads, size, color) -> dict:
    """A rectangle below the ceiling."""
    side = np.array([rng.uniform(0.2, 1.4), 0, rng.uniform(0.1, 0.6)])
    low = rng.uniform(0.05, 0.95, 3) * (size - side)
    low[1] = size[1] - 0.03
    a = np.array([side[0], 0, 0])
    b = np.array([0, 0, side[2]])
    return glowing(low, a, b, color * np.exp(rng.uniform(3.5, 6)))


def _screen(rng, quads: Quads, size, color) -> dict:
    """A bluish screen on a wall, whatever the other lamps' colour."""
    corner, a, b = _on_wall(
        rng, size, rng.uniform(0.4, 1.4), rng.uniform(0.3, 0.8), rng.uniform(0.7, 1.3), 0.06
    )
    brightness = rng.uniform(1, 8)
    return glowing(corner, a, b, brightness * textured(rng, np.array([0.7, 0.8, 0.9]), 5, 5, 0.5))


def _bulb(rng, quads: Quads, size, color) -> dict:
    """A small bright sphere that hangs or stands."""
    return _sphere(rng, quads, size, color, (0.03, 0.09), (6.5, 9.5))


def _shade(rng, quads: Quads, size, color) -> dict:
    """A large dim sphere that hangs or stands."""
    return _sphere(rng, quads, size, color, (0.12, 0.25), (3, 5.5))


def _sphere(rng, quads: Quads, size, color, radii, log_brightness) -> dict:
    """A glowing sphere on a pole from the ceiling, or from the floor where it hangs low."""
    radius = rng.uniform(*radii)
    at = rng.uniform(0.08, 0.92, 3) * size
    at[1] = size[1] - rng.uniform(0.1, 0.9) if rng.random() < 0.6 else rng.uniform(0.4, 1.6)
    brightness = np.exp(rng.uniform(*log_brightness))

    stands = at[1] < 1.7
    foot = 0 if stands else at[1] + radius
    top = at[1] - radius if stands else size[1]
    low = [at[0] - 0.01, foot, at[2] - 0.01]
    high = [at[0] + 0.01, top, at[2] + 0.01]
    quads.box(low, high, np.full(3, 0.1))
    return bulb(at, radius, color * brightness)


def _table(rng, quads: Quads, low, high, color) -> None:
    high[1] = rng.uniform(0.4, 0.8)
    quads.box([low[0], high[1] - 0.05, low[2]], high, color)
    for x in (low[0], high[0] - 0.06):
        for z in (low[2], high[2] - 0.06):
            quads.box([x, 0, z], [x + 0.06, high[1] - 0.05, z + 0.06], color)


def _sofa(rng, quads: Quads, low, high, color) -> None:
    quads.box(low, [high[0], 0.45, high[2]], color)
    quads.box(low, [high[0], 0.85, low[2] + 0.25], color)


def _shelf(rng, quads: Quads, low, high, color) -> None:
    quads.box(low, high, color)
    along = np.array([high[0] - low[0], 0, 0])
    for y in np.arange(0.15, high[1] - 0.1, 0.35):
        books = np.clip(rng.uniform(0.05, 0.7, (9, 2, 3)), 0, 1)
        corner = np.array([low[0], y, high[2] + 0.01])
        quads.add(corner, along, np.array([0, 0.28, 0]), books)


def _cupboard(rng, quads: Quads, low, high, color) -> None:
    quads.box(low, high, textured(rng, color, 4, 4, rng.uniform(0, 0.8)))


def _picture(rng, quads: Quads, size) -> None:
    corner, a, b = _on_wall(
        rng, size, rng.uniform(0.3, 1.5), rng.uniform(0.3, 1), rng.uniform(0.9, 1.6), 0.01
    )
    quads.add(corner, a, b, textured(rng, paint(rng, 0.03, 0.7, 0.4), 4, 4, 0.8))


def _door(rng, quads: Quads, size) -> None:
    corner, a, b = _on_wall(rng, size, 0.9, 2.05, 0, 0.01)
    quads.add(corner, a, b, textured(rng, paint(rng, 0.03, 0.7, 0.4), 4, 4, 0.1))


ON_WALLS = {"picture": _picture, "door": _door}
ON_FLOOR = {"box": _cupboard, "table": _table, "sofa": _sofa, "shelf": _shelf}
SMALLEST = np.array([0.15, 0.15, 0.15])
LARGEST = np.array([2.2, 2.4, 1.2])


def _furniture(rng, quads: Quads, size, eye) -> None:
    """Cupboards, tables, sofas, shelves, pictures, doors; nothing within 0.5 m of the eye."""
    for _ in range(int(np.exp(rng.uniform(np.log(4), np.log(45))))):
        kind = rng.choice(["box", "box", "table", "sofa", "shelf", "picture", "picture", "door"])
        if kind in ON_WALLS:
            ON_WALLS[kind](rng, quads, size)
            continue

        extent = np.exp(rng.uniform(np.log(SMALLEST), np.log(LARGEST)))
        if not rng.random() < 0.5:
            extent = extent[::-1]
        low = rng.uniform(0, 1, 3) * (size - extent)
        low[1] = 0
        if (np.abs(low + extent / 2 - eye)[[0, 2]] < extent[[0, 2]] / 2 + 0.5).all():
            continue
        ON_FLOOR[kind](rng, quads, low, low + extent, paint(rng, 0.02, 0.6, 0.5))


def _soft_box(rng, eye, ceiling: float) -> dict:
    """A rectangle that faces the eye, brightest in its middle."""
    x = rng.normal()
    y = abs(rng.normal()) * 0.7 + rng.choice([0.2, 0.6, 2.0])
    toward = np.array([x, y, rng.normal()])
    toward /= np.linalg.norm(toward)
    at = eye + toward * rng.uniform(1.0, 2.0)
    at[1] = min(at[1], ceiling - 0.05)

    a = np.cross(toward, [0, 1, 0.01])
    a /= np.linalg.norm(a)
    b = np.cross(toward, a)
    width, height = np.exp(rng.uniform(np.log(0.15), np.log(1.6), 2))

    off_middle = np.linspace(-1, 1, 7) ** 2
    down = -rng.uniform(0, 1.5) * off_middle[:, None, None]
    across = rng.uniform(0, 1.5) * off_middle[None, :, None]
    fall = np.exp(down - across)
    radiance = np.exp(rng.uniform(0.5, 3.5)) * warm(rng) ** rng.uniform(-0.5, 1)
    corner = at - a * width / 2 - b * height / 2
    return glowing(corner, b * height, a * width, radiance * fall)


def indoor(rng: np.random.Generator, h: int, w: int, spp: int = 16) -> np.ndarray:
    """A furnished room with windows by day, lamps, or both: radiance (h, w, 3)."""
    size = np.array([rng.uniform(2.8, 11), rng.uniform(2.3, 4.5), rng.uniform(2.8, 11)])
    eye = rng.uniform([0.2, 0.25, 0.2], [0.8, 0.6, 0.8]) * size
    quads = Quads()
    _shell(rng, quads, size)
    _furniture(rng, quads, size, eye)

    lamps = _lamps(rng, quads, size)
    sun = None
    if not lamps or rng.random() < 0.6:
        sky = np.exp([-0.15, 0, 0.2] * rng.uniform(-0.5, 1.5, 3))
        brightness = np.exp(rng.uniform(2.5, 4.5))
        lamps += [_window(rng, quads, size, sky, brightness) for _ in range(rng.integers(1, 4))]
        if rng.random() < 0.35:
            towards = np.array([rng.normal(), rng.uniform(0.3, 1.2), rng.normal()])
            irradiance = brightness * rng.uniform(5, 20) * np.array([1.1, 1, 0.85])
            sun = (towards / np.linalg.norm(towards), irradiance)

    env = trace(quads, lamps, eye, h, w, spp, int(rng.integers(2**20)), sun)
    return white_balanced(rng, np.roll(env, rng.integers(w), 1))


def studio(rng: np.random.Generator, h: int, w: int, spp: int = 16) -> np.ndarray:
    """A product studio: dark or grey room, soft boxes and strips around the eye, often a bright
    table or backdrop.
    """
    size = np.array([rng.uniform(4, 10), rng.uniform(3, 5), rng.uniform(4, 10)])
    eye = np.array([0.5, 0.35, 0.5]) * size + rng.uniform(-0.4, 0.4, 3)
    quads = Quads()
    shade = np.exp(rng.uniform(np.log(0.15), np.log(0.95)))
    quads.box([0, 0, 0], size, np.clip(shade * paint(rng, 0.7, 0.9, 0.4), 0.01, 0.9))
    table = textured(rng, paint(rng, 0.1, 0.7, 0.3), 17, 17, rng.uniform(0, 0.3))
    quads.add(np.array([0, 0.005, 0]), np.array([0, 0, size[2]]), np.array([size[0], 0, 0]), table)
    if rng.random() < 0.4:
        quads.box(eye - [0.8, 0.9, 0.8], eye + [0.8, -0.35, 0.8], paint(rng, 0.05, 0.85, 0.3))
    if rng.random() < 0.6:
        _furniture(rng, quads, size, eye)

    lamps = [_soft_box(rng, eye, size[1]) for _ in range(rng.integers(1, 7))]
    return white_balanced(rng, trace(quads, lamps, eye, h, w, spp, int(rng.integers(2**20))))
