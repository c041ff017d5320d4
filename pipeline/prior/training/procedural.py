"""Procedural lat-long lights, so that the prior sees more suns, skies, windows and lamps than a
hundred photographs hold.

Outdoor: Mitsuba's sun-and-sky model (Wilkie et al. 2021) over ground, skyline and clouds of noise.
Night: lamps over the same. Indoor and studio: path-traced rooms (`rooms`). `benchmarks/lights.py`
holds their statistics against measured maps. Arrays are (h, w, 3) relative radiance.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter

from pipeline.base.progress import progress
from pipeline.prior.weight_facts import LABELS
from pipeline.render.envmap import directions, solid_angles

SUN_HALF_ANGLE = np.radians(0.2665)
EARTH = [0.35, 0.3, 0.22]
GRASS = [0.2, 0.3, 0.1]
STONE = [0.5, 0.5, 0.5]
SAND = [0.5, 0.4, 0.2]
GROUNDS = [EARTH, GRASS, STONE, SAND]
CLASSES = {"outdoor": 0.45, "indoor": 0.3, "studio": 0.2, "night": 0.05}  # shares of what is made


def noise(
    rng, h: int, w: int, smooth: float, octaves: int = 4, persistence: float = 0.5
) -> np.ndarray:
    """Fractal noise, wrapped in longitude, zero mean and unit variance; `smooth` is the coarsest
    blur in pixels.

    Every octave has half the blur of the one before and `persistence` times its amplitude.
    """
    out = np.zeros((h, w))
    for octave in range(octaves):
        white = rng.normal(size=(h, w))
        layer = gaussian_filter(white, smooth / 2**octave, mode=("nearest", "wrap"))
        out += layer / (layer.std() + 1e-9) * persistence**octave
    return out / out.std()


def _sky_radiance(
    sun: np.ndarray, turbidity: float, albedo: float, d: np.ndarray, disc: bool
) -> np.ndarray:
    """Evaluate Mitsuba's `sunsky` emitter in directions d (..., 3), Y-up; sky only, or the sun's
    disc only.
    """
    import drjit as dr

    from pipeline.base.runtime import mitsuba as mi

    turn = mi.ScalarTransform4f().rotate([1, 0, 0], -90)  # the emitter is Z-up
    emitter = mi.load_dict(
        {
            "type": "sunsky",
            "sun_direction": [sun[0], sun[1], sun[2]],
            "turbidity": turbidity,
            "albedo": albedo,
            "to_world": turn,
            "sun_scale": float(disc),
            "sky_scale": float(not disc),
        }
    )
    si = dr.zeros(mi.SurfaceInteraction3f, d.size // 3)
    si.wi = -mi.Vector3f(np.ascontiguousarray(d.reshape(-1, 3).T, np.float32))
    return np.array(emitter.eval(si)).T.reshape(d.shape)


def outdoor(rng: np.random.Generator, h: int, w: int) -> np.ndarray:
    """Sun, its glow and sky over a ground with a skyline of hills, trees or buildings, and
    clouds.
    """
    d = directions(h, w)
    weight = solid_angles(h, w)
    elevation = np.radians(rng.uniform(2, 75))
    azimuth = rng.uniform(0, 2 * np.pi)
    x = np.cos(elevation) * np.sin(azimuth)
    z = np.cos(elevation) * np.cos(azimuth)
    sun = np.array([x, np.sin(elevation), z])
    turbidity = rng.uniform(1.5, 9.5)
    ground_albedo = rng.uniform(0.05, 0.5)

    up = np.maximum(d, [-1, 0.02, -1])
    up = up / np.linalg.norm(up, axis=-1, keepdims=True)
    sky = _sky_radiance(sun, turbidity, ground_albedo, up, False)
    cover = rng.uniform(-2.5, 1.2)
    clouds = 1 / (1 + np.exp(-rng.uniform(2, 8) * (noise(rng, h, w, h / 6, 6, 0.6) + cover)))
    grey = sky.mean((0, 1)).mean() * rng.uniform(0.5, 3)
    billows = np.exp(0.4 * noise(rng, h, w, h / 8, 5, 0.6))[..., None]
    sky = sky * (1 - clouds[..., None]) + clouds[..., None] * grey * billows

    row, column = np.unravel_index((d @ sun).argmax(), (h, w))
    disc = _sky_radiance(sun, turbidity, ground_albedo, sun[None], True)[0]
    flux = disc * np.pi * SUN_HALF_ANGLE**2
    flux = flux * (1 - clouds[row, column]) ** rng.uniform(1, 4)
    ambient = (sky * np.maximum(d[..., 1:2], 0) * weight[..., None]).sum((0, 1)) / np.pi
    ambient = ambient + flux * sun[1] / np.pi

    spread = np.exp(rng.uniform(np.log(0.05), np.log(0.5)))  # share in haze and lens glare
    sky[row, column] += (1 - spread) * flux / weight[row, column]
    glow = _glow(d @ sun, np.radians(rng.uniform(0.5, 4)), weight)[..., None]
    sky += spread * flux * glow
    return _with_ground(rng, sky, d, ambient, sun, flux.mean() / ambient.mean())


def _glow(cosine, width: float, weight) -> np.ndarray:
    """Glare around the sun, 1 / (1 + (angle / width)^2)^1.5, with unit integral over the sphere."""
    angle = np.arccos(np.clip(cosine, -1, 1))
    shape = (1 + (angle / width) ** 2) ** -1.5
    return shape / (shape * weight).sum()


def _skyline(rng, w: int) -> np.ndarray:
    """Height of hills, trees or buildings over longitude in radians, (w,)."""
    steps = np.repeat(rng.normal(size=w), rng.integers(2, max(3, w // 12), w))[:w]
    steps = steps * (rng.random() < 0.4)
    rough = np.abs(noise(rng, 1, w, w / 12, 7, rng.uniform(0.4, 0.8))[0]) + np.abs(steps)
    return np.radians(rng.choice([1, 5, 15, 30]) * rough + rng.uniform(-2, 6))


def _with_ground(rng, sky, d, ambient, sun, directness):
    """Everything below a skyline becomes ground, hills, walls or trees: albedo times the light that
    falls there. `directness`: the sun's part of the light.
    """
    h, w = sky.shape[:2]
    grain = rng.uniform(0.3, 0.8)
    color = rng.uniform(0.3, 1) * rng.uniform(0.75, 1, 3) * rng.choice(GROUNDS)
    texture = np.exp(rng.uniform(0.1, 0.7) * noise(rng, h, w, h / 6, 6, grain))[..., None]
    ground = ambient * color * texture
    shade = noise(rng, h, w, h / 6, 4) > rng.uniform(0, 2.5)  # cast shadows lack the sun's share
    ground = np.where(shade[..., None], ground * (1 - min(0.9, 0.7 * directness)), ground)

    latitude = np.arcsin(np.clip(d[..., 1], -1, 1))
    # walls opposite the sun are lit by it
    facing = np.clip(0.6 - 0.5 * (d @ (sun * [1, 0, 1])), 0.05, 1.2)
    color = ambient * rng.uniform(0.05, 0.5) * rng.uniform(0.3, 1, 3)
    texture = np.exp(rng.uniform(0.2, 0.9) * noise(rng, h, w, h / 10, 6, grain))
    upright = color * (facing * texture)[..., None]

    below = np.where((latitude > 0)[..., None], upright, ground)
    return np.where((latitude < _skyline(rng, w))[..., None], below, sky)


def night(rng: np.random.Generator, h: int, w: int) -> np.ndarray:
    """Street lamps and lit windows under a dim sky; the ground is lit by the lamps around it."""
    d = directions(h, w)
    latitude = np.arcsin(np.clip(d[..., 1], -1, 1))
    sky = np.exp(rng.uniform(-0.5, 2.5) + 0.3 * noise(rng, h, w, h / 6, 5))[..., None]
    sky = sky * rng.uniform([0.5, 0.6, 0.7], [1.3, 1.0, 1.4])
    sky = sky * np.exp(-rng.uniform(0, 2) * np.maximum(latitude, 0))[..., None]

    lamps = np.zeros((h, w, 3))
    lit = np.zeros((h, w))
    for _ in range(rng.integers(2, 25)):
        row = int(h * (0.5 - abs(rng.normal(0.05, 0.12)))) % h
        column = rng.integers(w)
        tint = np.array([1 + rng.uniform(0, 0.8), 1, 1 - rng.uniform(0, 0.8)])
        color = tint * np.exp(rng.uniform(4, 9)) * 16 / h
        tall = rng.integers(1, 3)
        lamps[row : row + tall, column : column + rng.integers(1, 4)] = color

        below = d[min(int(0.5 * h + rng.uniform(0.03, 0.4) * h), h - 1), column]
        near = np.exp(-((d - below) ** 2).sum(-1) / rng.uniform(0.02, 0.5))
        lit += near * rng.uniform(1, 20)

    front = np.exp(rng.uniform(0.4, 1.2) * noise(rng, h, w, h / 8, 6, rng.uniform(0.5, 0.9)))
    color = rng.uniform([0.3, 0.25, 0.1], [1, 0.8, 0.6])
    ground = (0.3 + lit)[..., None] * front[..., None] * color
    return np.where((latitude < _skyline(rng, w))[..., None], ground, sky) + lamps


def generate(count: int, height: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """`count` maps (n, h, 2h, 3) and labels as in `weight_facts.LABELS` (n,); map k depends on
    (seed, k) alone.
    """
    from pipeline.prior.training import rooms

    makers = {"outdoor": outdoor, "indoor": rooms.indoor, "studio": rooms.studio, "night": night}
    maps = []
    labels = []
    for k in progress(range(count), "procedural lights"):
        rng = np.random.default_rng([seed, k])
        name = rng.choice(list(CLASSES), p=list(CLASSES.values()))
        maps.append(makers[name](rng, height, 2 * height).astype(np.float32))
        labels.append(LABELS.index(name))
    return np.array(maps, np.float32).reshape(count, height, 2 * height, 3), np.array(labels, int)
